"""The process in which a module is imported with a mistake: constants, tables, defaults."""

import sys

from metro_tools.mutate.trial import try_anew

if __name__ == "__main__":
    root, module, number, order, *tests = sys.argv[1:]
    sys.exit(try_anew(root, module, int(number), order, tests))
