"""Merges all DBC files into one, for tools that accept only one: `python -m can_dbc.merged >
train.dbc`.
"""

import sys
from importlib import resources
from typing import Final

from cantools.database.can import Database

from can_dbc import dbc_file

LAST: Final = "diagnostics.dbc"
"""File to read last. It defines every attribute and comments the nodes; cantools keeps these of the
last file."""


def merged() -> str:
    """Return the text of one DBC file with every message."""
    database = Database(strict=True)
    for name in sorted(dbc_file.names(), key=lambda each: (each == LAST, each)):
        text = (resources.files("can_dbc") / name).read_text(encoding="ascii")
        database.add_dbc_string(text)
    return database.as_dbc_string(sort_signals=None).replace("\r\n", "\n")


if __name__ == "__main__":
    sys.stdout.write(merged())
