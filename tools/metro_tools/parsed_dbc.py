"""Writes the parsed DBC files from which programs start."""

import sys
from collections.abc import Sequence
from typing import Final

from can_dbc import dbc_file, parsed_files
from metro_tools.generated_doc import write_or_check

DEFAULT_PATH: Final = f"can_dbc/{parsed_files.NAME}"


def document() -> str:
    """Return the text of the file, from the DBC files of the package."""
    rows = []
    for name in dbc_file.names():
        text = dbc_file.text_of(name)
        file = dbc_file.parse(text, name)
        rows.append(parsed_files.row(name, text, [*file.messages.values()], file.nodes))
    return "{" + ",\n".join(rows) + "}\n"


def main(argv: Sequence[str] | None = None) -> int:
    """Write the file, or with --check only report whether it is current."""
    return write_or_check(
        argv,
        module="metro_tools.parsed_dbc",
        description=__doc__,
        default_path=DEFAULT_PATH,
        document=document,
    )


if __name__ == "__main__":
    sys.exit(main())
