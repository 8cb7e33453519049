"""Guesses what a file is that is not a CAN log, for the message that refuses it."""

import re
from typing import Final

STARTS: Final = (
    (b"%PDF", "a PDF document"),
    (b"PK\x03\x04", "a ZIP archive or office document; unpack it first"),
    (b"\x1f\x8b", "a gzip file"),
    (b"7z\xbc\xaf", "a 7-Zip archive; unpack it first"),
    (b"Rar!", "a RAR archive; unpack it first"),
    (b"BZh", "a bzip2 file; unpack it first"),
    (b"\xfd7zXZ", "an xz file; unpack it first"),
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"\x7fELF", "a program"),
    (b"MZ", "a Windows program"),
    (b"\x89HDF", "an HDF5 or MATLAB file"),
    (b"MATLAB", "a MATLAB file"),
    (b"SQLite format 3", "an SQLite database"),
    (b"RIFF", "a sound or video file"),
    (b"VERSION", "a DBC file; --dbc takes it"),
    (b"BO_ ", "a DBC file; --dbc takes it"),
    (b"FormatVersion=", "a SYM file; --dbc takes it"),
    (b"@ TEXT @", "a trace of CARBUS Analyzer"),
    (b"Generated", "a report"),
)
PATTERNS: Final = (
    (rb"<\?xml.*(?:kayak|NetworkDefinition)", "a KCD file; --dbc takes it"),
    (rb"<\?xml.*AUTOSAR", "an ARXML file; --dbc takes it"),
    (rb"\s*<\?xml|\s*<[a-zA-Z]+", "an XML or HTML file"),
    (rb"\s*[{\[]", "a JSON file"),
    (rb"\d+\.\d+ [CR]\w\w ", "a CRTD log of OVMS"),
    (rb"[^\n]*;[^\n]*;[^\n]*;", "a table with semicolons"),
    (rb"[^\n]*,[^\n]*,[^\n]*,", "a CSV table of unknown columns"),
    (rb"[^\n]*\t[^\n]*\t", "a table with tabs"),
)
COLUMNS_SHOWN: Final = 60


def looks_like(head: bytes) -> str:
    """Describe a file by its first bytes."""
    if not head:
        return "an empty file"
    head = head.removeprefix(b"\xef\xbb\xbf")
    for start, name in STARTS:
        if head.startswith(start):
            return name
    if b"\0" in head:
        return "binary data"
    for pattern, name in PATTERNS:
        if re.match(pattern, head, re.DOTALL | re.IGNORECASE):
            return name
    first = head.split(b"\n")[0][:COLUMNS_SHOWN].decode("utf-8", "replace").strip()
    return f"text that begins {first!r}"
