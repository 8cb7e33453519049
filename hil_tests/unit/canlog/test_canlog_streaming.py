"""Logs of any size are streamed: no writer keeps the blocks that it has written."""

import tempfile
import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from canlog import shelf
from canlog.damage import Damages, LogError
from canlog.drawn import drawn_frames
from canlog.formats.registry import FORMATS, named
from canlog.frames import Frames, concat
from canlog.options import ReadOptions
from canlog.reader import read
from canlog.views.packed import ordered
from hil_tests.unit.canlog import canlog_rig as rig

NAMES = [each.name for each in FORMATS if each.writes]
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
    """The log repeats the same minutes, so sorting would need all frames of the first part."""
    one = drawn_frames(5, 900, classic=True)
    blocks = [one[at : at + 100] for at in range(0, 900, 100)]
    losses = Damages()

    named("mf4").write(tmp_path / "x.mf4", [*blocks, *blocks], losses)
    found = read(tmp_path / "x.mf4").frames

    assert [each.kind for each in losses.all()] == ["order"]
    assert found.at_ns.tolist() == np.repeat(one.at_ns, 2).tolist()
    assert sorted(found.identifier.tolist()) == sorted(one.identifier.tolist() * 2)


@pytest.mark.parametrize("classic", [True, False])
def test_columns_on_disk_are_those_in_memory(
    tmp_path: Path, classic: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The blocks have several widths and channels; all columns go to files, however small."""
    monkeypatch.setattr(shelf, "ON_DISK_BYTES", 1)
    monkeypatch.setattr(shelf, "PIECE", 64)
    frames = drawn_frames(8, 700, classic=classic)
    path = tmp_path / "x.log"
    late = np.concatenate([frames.at_ns[300:], frames.at_ns[:300]])
    named("candump").write(path, [replace(frames, at_ns=late)], Damages())

    near = read(path, rig.bus(), ReadOptions(block_frames=100))
    far = read(path, rig.bus(), ReadOptions(block_frames=100, on_disk=True))
    near_rows, far_rows = ordered(near.frames), ordered(far.frames, far.room)

    for name in ("at_ns", "identifier", "flags", "channel", "length", "data"):
        assert (getattr(near.frames, name) == getattr(far.frames, name)).all()
        assert (getattr(near_rows.frames, name) == getattr(far_rows.frames, name)).all()
    assert near.frames.channels == far.frames.channels
    assert [(each.key, each.flags, each.rows.tolist()) for each in near_rows.groups] == [
        (each.key, each.flags, each.rows.tolist()) for each in far_rows.groups
    ]
    for name in near.messages:
        assert near.table(name).rows.tolist() == far.table(name).rows.tolist()
        for signal in near.table(name).names:
            one, other = near.table(name)[signal], far.table(name)[signal]
            assert np.array_equal(one, other, equal_nan=one.dtype.kind == "f")


def test_wider_data_may_come_late() -> None:
    blocks = [drawn_frames(1, 50, classic=True), drawn_frames(2, 50), drawn_frames(3, 50)]

    found, wanted = shelf.shelved(blocks), concat(blocks)

    assert (found.data == wanted.data).all()
    assert found.channels == wanted.channels
    assert found.channel.tolist() == wanted.channel.tolist()


def test_a_full_disk_is_told_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(**_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", full)

    with pytest.raises(LogError, match="no room for the columns of the log: No space left"):
        shelf.on_disk(shelf.ON_DISK_BYTES, np.uint8)
    with pytest.raises(LogError, match="no room for the columns of the log"):
        shelf.shelved([drawn_frames(1, 5)])
