"""Generates the code of a wire from DBC files: `python -m can_dbc.wire --lang c FILE.dbc`.

Without files it generates that of the train bus. The code has the checks of `can_dbc.codec`. The
attributes Protection, SafetyDataId and TimeoutMs of the file choose the protection of a message.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from can_dbc import c_source, derived, python_source, rust_source
from can_dbc.binding import BindingError

EXIT_OK, EXIT_USAGE, EXIT_ENVIRONMENT = 0, 2, 3
LANGUAGES = {
    "c": c_source.wire_files,
    "python": python_source.wire_files,
    "rust": rust_source.wire_files,
}


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m can_dbc.wire", description=__doc__)
    parser.add_argument("files", nargs="*", metavar="FILE", type=Path, help="DBC files")
    parser.add_argument("--lang", choices=list(LANGUAGES), default="c", help="default: c")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path(), metavar="FOLDER", help="default: this folder"
    )
    options = parser.parse_args(argv)
    try:
        chosen = derived.bindings(options.files) if options.files else c_source.shipped_bindings()
    except BindingError as error:
        print(
            "\n".join(f"can_dbc.wire: {line}" for line in str(error).splitlines()), file=sys.stderr
        )
        return EXIT_USAGE
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        for name, text in LANGUAGES[options.lang](chosen).items():
            (options.out / name).write_text(text, encoding="utf-8")
            print(f"wrote {options.out / name}")
    except OSError as error:
        print(f"can_dbc.wire: {error.filename}: {error.strerror}", file=sys.stderr)
        return EXIT_ENVIRONMENT
    return EXIT_OK


if __name__ == "__main__":
    sys.exit(main())
