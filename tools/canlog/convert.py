"""Converts a log block by block; it lists what the target format cannot hold."""

from dataclasses import replace
from pathlib import Path

from canlog.damage import Damage, Damages, LogError
from canlog.database import Bus
from canlog.formats.registry import FORMATS, by_suffix, chained, named
from canlog.options import ReadOptions
from canlog.reader import stream
from firmware_py.storage.whole_file import whole_file


def convert(
    source: Path,
    target: Path,
    *,
    form: str | None = None,
    options: ReadOptions | None = None,
    bus: Bus | None = None,
    overwrite: bool = False,
) -> tuple[tuple[Damage, ...], tuple[Damage, ...]]:
    """Return the damage in the source, and the losses in the target.

    Args:
        form: name of the target's format; None derives it from the suffix of `target`.
        bus: bus whose signals an MCAP file gets beside the frames.

    Raises:
        LogError: when the source cannot be read or the target cannot be written.
    """
    found = named(form) if form else by_suffix(target)
    if found is None:
        known = ", ".join(each.name for each in FORMATS if each.writes)
        raise LogError(f"{target}: its suffix names no known format; --to takes {known}")
    write = found.write
    blocks = stream(source, replace(options or ReadOptions(), refuse_empty=True))
    if target.exists() and not overwrite:
        raise LogError(f"{target}: already exists; --force replaces it")
    losses = Damages()
    # A source without frames raises here, before the target is opened.
    frames = iter(blocks)
    content = chained(next(block for block in frames if len(block)), frames)
    with whole_file(target) as part:
        if found.name == "mcap":
            write(part, content, losses, bus)
        else:
            write(part, content, losses)
    return blocks.warnings, losses.all()
