"""The compiled kernel for text and bits, where this machine has one; else numpy does the same."""

from typing import Any


def parse_candump(text: bytes, channels: list[str], width: int) -> Any:
    """What `parse_block` gives, or None when there is no kernel."""
    del text, channels, width
    return None
