"""First bytes of each format, so that canlog loads only the reader of the recognised format."""

import re
from typing import Final

UTF8_MARK: Final = b"\xef\xbb\xbf"
PCAP_MAGICS: Final = (
    b"\xa1\xb2\xc3\xd4",
    b"\xd4\xc3\xb2\xa1",
    b"\xa1\xb2\x3c\x4d",
    b"\x4d\x3c\xb2\xa1",
)
"""Magic numbers for stamps in micro- or nanoseconds, in either byte order."""
PCAPNG_SECTION: Final = b"\n\r\r\n"
KVASER: Final = re.compile(rb"\s*Chn\s+Identifier\s+Flg", re.IGNORECASE)
KVASER_LINES: Final = 40
"""Number of lines searched for the column head; settings may stand before it."""


def is_pcap(head: bytes) -> bool:
    return head[:4] in PCAP_MAGICS or (head[:4] == PCAPNG_SECTION and len(head) >= 12)


def is_sqlite(head: bytes) -> bool:
    return head.startswith(b"SQLite format 3\0")


def is_gvret(head: bytes) -> bool:
    return head.removeprefix(UTF8_MARK).lower().startswith(b"time stamp,id,extended")


def is_python_can_csv(head: bytes) -> bool:
    return head.startswith(b"timestamp,arbitration_id,extended,remote,error,dlc,data")


def is_busmaster(head: bytes) -> bool:
    return head.removeprefix(UTF8_MARK).lstrip().startswith(b"***BUSMASTER")


def is_microchip(head: bytes) -> bool:
    return b"Microchip Technology Inc." in head[:400]


def is_kvaser(head: bytes) -> bool:
    return any(KVASER.match(line) for line in head.split(b"\n")[:KVASER_LINES])
