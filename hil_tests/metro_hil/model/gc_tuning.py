"""Python looks for cycles of objects far less often where much runs that leaves none behind."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

COLLECT_AFTER: Final = 50_000
"""New objects after which cycles are looked for."""


def collect_rarely() -> None:
    """From now on in this process, unless somebody set it to be rarer, or off."""
    usual = gc.get_threshold()
    if 0 < usual[0] < COLLECT_AFTER:
        gc.set_threshold(COLLECT_AFTER, *usual[1:])


@contextmanager
def rarely_collected() -> Iterator[None]:
    """Within the block, and as it was after it."""
    usual = gc.get_threshold()
    collect_rarely()
    try:
        yield
    finally:
        gc.set_threshold(*usual)
