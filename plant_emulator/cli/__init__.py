"""`plant`: serves a train without a controller on a bus, a serial line and a radio."""

from collections.abc import Sequence

from firmware_py.arguments import words_of
from firmware_py.assertions import require_assertions
from plant_emulator.cli.options import parser

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """The console script `plant`. User errors give one line, never a traceback."""
    require_assertions("plant")
    words = words_of("plant", argv)
    if words[:1] == ["run"] and "--wayside" in words:
        words.remove("--wayside")
        words[0] = "wayside"
    options = parser().parse_args(words)
    # Help and mistakes need no train, so these words are parsed first.
    from plant_emulator.cli.command import serve

    return serve(options)
