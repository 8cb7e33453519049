"""Every key expression of the radio, and how keys are matched.

Keys begin with the writer: `m/<line>/w/<writer>/...`, so that one access rule for each identity is
enough. `<writer>` is the address of messages.py in decimal; `<line>` is the line's name in the form
of `line_chunk`.
"""

import re
from functools import lru_cache
from typing import Final

DEFAULT_AREA: Final = 1
"""Area of a line with a single area."""

_UNUSUAL: Final = re.compile(r"[^a-z0-9_-]+")


def report(line: str, train: int, area: int = DEFAULT_AREA) -> str:
    """Key of a train's PositionReport."""
    return f"m/{line_chunk(line)}/w/{train}/st/{area}"


def reports(line: str, area: int = DEFAULT_AREA) -> str:
    """Subscription of an area's wayside: the reports of all trains in it."""
    return f"m/{line_chunk(line)}/w/*/st/{area}"


def authority(line: str, source: int, train: int, area: int = DEFAULT_AREA) -> str:
    """Key of the MovementAuthority for a train from an issuer."""
    return f"m/{line_chunk(line)}/w/{source}/ma/{area}/{train}"


def authorities(line: str, train: int) -> str:
    """Subscription of a train: its authorities from any issuer in any area."""
    return f"m/{line_chunk(line)}/w/*/ma/*/{train}"


def status(line: str, train: int, area: int = DEFAULT_AREA) -> str:
    """Key of a train's TrainStatus."""
    return f"m/{line_chunk(line)}/w/{train}/ts/{area}"


def statuses(line: str, area: int = DEFAULT_AREA) -> str:
    """Subscription of the centre: the status of all trains in an area."""
    return f"m/{line_chunk(line)}/w/*/ts/{area}"


def order(line: str, source: int, train: int, area: int = DEFAULT_AREA) -> str:
    """Key of the TrainOrders for a train from a centre."""
    return f"m/{line_chunk(line)}/w/{source}/or/{area}/{train}"


def orders(line: str, train: int) -> str:
    """Subscription of a train: its orders from any centre in any area."""
    return f"m/{line_chunk(line)}/w/*/or/*/{train}"


@lru_cache(maxsize=64)
def line_chunk(name: str) -> str:
    """Return a line's name as one chunk of a key: lower case, with hyphens for unusual
    characters.
    """
    return _UNUSUAL.sub("-", name.lower()).strip("-") or "line"


@lru_cache(maxsize=1024)
def matches(expression: str, key: str) -> bool:
    """Return whether a key expression includes a key.

    `*` is any one chunk, `**` any number of chunks, including none. Raises ValueError for an
    expression or a key that zenoh would not accept, and for `$*`, which this project does not use.
    """
    wanted, chunks = expression.split("/"), key.split("/")
    for chunk in wanted:
        if not chunk or ("*" in chunk and chunk not in ("*", "**")) or set(chunk) & set("$#?"):
            raise ValueError(f"{expression}: not a key expression that is used here")
    for chunk in chunks:
        if not chunk or set(chunk) & set("*$#?"):
            raise ValueError(f"{key}: not a key")
    return _chunks_match(wanted, chunks)


def _chunks_match(wanted: list[str], chunks: list[str]) -> bool:
    if not wanted:
        return not chunks
    if wanted[0] == "**":
        return any(_chunks_match(wanted[1:], chunks[at:]) for at in range(len(chunks) + 1))
    if not chunks or wanted[0] not in ("*", chunks[0]):
        return False
    return _chunks_match(wanted[1:], chunks[1:])
