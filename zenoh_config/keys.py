"""Every key expression of the radio, and how one is matched.

Keys begin with who writes: `m/<line>/w/<writer>/...`, so that one access rule for each identity is
enough. `<writer>` is the address of messages.py in decimal; `<line>` is the line's name as
`line_chunk` spells it.
"""

import re
from functools import lru_cache
from typing import Final

DEFAULT_AREA: Final = 1
"""A line of one area; hand-over between areas brings more."""

_UNUSUAL: Final = re.compile(r"[^a-z0-9_-]+")


def report(line: str, train: int, area: int = DEFAULT_AREA) -> str:
    """Where a train puts its PositionReport."""
    return f"m/{line_chunk(line)}/w/{train}/st/{area}"


def reports(line: str, area: int = DEFAULT_AREA) -> str:
    """What the wayside of an area listens to: the reports of all trains in it."""
    return f"m/{line_chunk(line)}/w/*/st/{area}"


def authority(line: str, source: int, train: int, area: int = DEFAULT_AREA) -> str:
    """Where an issuer puts the MovementAuthority of a train."""
    return f"m/{line_chunk(line)}/w/{source}/ma/{area}/{train}"


def authorities(line: str, train: int) -> str:
    """What a train listens to: its authorities, whoever issues them in whatever area."""
    return f"m/{line_chunk(line)}/w/*/ma/*/{train}"


def status(line: str, train: int, area: int = DEFAULT_AREA) -> str:
    """Where a train puts its TrainStatus."""
    return f"m/{line_chunk(line)}/w/{train}/ts/{area}"


def statuses(line: str, area: int = DEFAULT_AREA) -> str:
    """What the centre listens to: the status of all trains in an area."""
    return f"m/{line_chunk(line)}/w/*/ts/{area}"


def order(line: str, source: int, train: int, area: int = DEFAULT_AREA) -> str:
    """Where a centre puts the TrainOrders of a train."""
    return f"m/{line_chunk(line)}/w/{source}/or/{area}/{train}"


def orders(line: str, train: int) -> str:
    """What a train listens to: its orders, whoever gives them in whatever area."""
    return f"m/{line_chunk(line)}/w/*/or/*/{train}"


@lru_cache(maxsize=64)
def line_chunk(name: str) -> str:
    """A line's name as one chunk of a key: lower case, everything unusual a hyphen."""
    return _UNUSUAL.sub("-", name.lower()).strip("-") or "line"


@lru_cache(maxsize=1024)
def matches(expression: str, key: str) -> bool:
    """Whether a key is one of those that a key expression means.

    `*` is any one chunk, `**` any number of them, none included. Raises ValueError for an
    expression or a key that zenoh would not take, and for the `$*` that nothing here uses.
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
