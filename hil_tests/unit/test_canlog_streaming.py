"""Logs of any size go through in a stream: nothing holds on to what it has done with."""

import weakref
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from metro_tools.canlog.damage import Damages
from metro_tools.canlog.drawn import drawn_frames
from metro_tools.canlog.formats.registry import FORMATS, named
from metro_tools.canlog.frames import Frames
from metro_tools.canlog.read import read

NAMES = [each.name for each in FORMATS]
BLOCKS, HELD_MAX = 24, 5


@pytest.mark.parametrize("form", NAMES)
def test_no_writer_holds_more_than_a_few_blocks(tmp_path: Path, form: str) -> None:
    alive: weakref.WeakValueDictionary[int, np.ndarray] = weakref.WeakValueDictionary()
    most = 0

    def blocks() -> Iterator[Frames]:
        nonlocal most
        for number in range(BLOCKS):
            block = drawn_frames(number, 60, fine=False)
            at_ns = block.at_ns + number * 1_000_000_000_000
            alive[number] = at_ns
            made = Frames(at_ns, block.identifier, block.flags, block.channel, block.length,
                          block.data, block.channels)  # fmt: skip
            most = max(most, len(alive))
            del block, at_ns
            yield made

    path = tmp_path / f"x{named(form).suffixes[0]}"
    named(form).write(path, blocks(), Damages())

    assert most <= HELD_MAX
    assert len(read(path)) == BLOCKS * 60


def test_mf4_keeps_frames_that_come_far_too_late(tmp_path: Path) -> None:
    """Two logs of the same minutes behind each other: sorting would need all of the first."""
    one = drawn_frames(5, 900, classic=True)
    blocks = [one[at : at + 100] for at in range(0, 900, 100)]
    losses = Damages()

    named("mf4").write(tmp_path / "x.mf4", [*blocks, *blocks], losses)
    found = read(tmp_path / "x.mf4").frames

    assert [each.kind for each in losses.all()] == ["order"]
    assert found.at_ns.tolist() == np.repeat(one.at_ns, 2).tolist()
    assert sorted(found.identifier.tolist()) == sorted(one.identifier.tolist() * 2)
