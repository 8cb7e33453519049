"""Raises the garbage-collection threshold for allocation-heavy code that creates few cycles."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

COLLECT_AFTER: Final = 50_000
"""Number of new objects after which the collector looks for cycles."""


def collect_rarely() -> None:
    """Raise the threshold of this process, unless it is higher already or collection is off."""
    usual = gc.get_threshold()
    if 0 < usual[0] < COLLECT_AFTER:
        gc.set_threshold(COLLECT_AFTER, *usual[1:])


@contextmanager
def rarely_collected() -> Iterator[None]:
    """Raise the threshold within the block and restore it afterwards."""
    usual = gc.get_threshold()
    collect_rarely()
    try:
        yield
    finally:
        gc.set_threshold(*usual)
