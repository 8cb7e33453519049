"""MF4 files of loggers: torn, unfinished, with packed bits, or with groups of other buses."""

import tempfile
from pathlib import Path

import asammdf
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog import Frames, LogError, ReadOptions, read, stream
from canlog.frames import BRS, EXTENDED, FD, TX, concat
from canlog.kernel import SWITCH, library
from hil_tests.unit.canlog.mf4_rig import MadeFrame, sorted_file, unsorted_file

START_NS = 1_700_000_000_000_000_000
RECORD = 20
FRAMES = st.lists(
    st.builds(
        MadeFrame,
        at_us=st.integers(0, 1 << 40),
        bus=st.integers(1, 3),
        identifier=st.integers(0, 0x7FF),
        extended=st.booleans(),
        sent=st.booleans(),
        fd=st.just(False),
        data=st.binary(max_size=8),
    ),
    max_size=30,
).map(lambda frames: sorted(frames, key=lambda each: each.at_us))


def many(count: int) -> list[MadeFrame]:
    """Return one frame per millisecond on two buses."""
    return [
        MadeFrame(at, 1 + at % 2, at % 0x800, at % 3 == 0, at % 5 == 0, fd=False,
                  data=bytes([at % 256] * (at % 9)))
        for at in range(count)
    ]  # fmt: skip


def told(frames: Frames) -> list[tuple[int, str, int, bool, bool, bytes]]:
    return [
        (
            (int(frames.at_ns[at]) - START_NS) // 1000,
            frames.channels[frames.channel[at]],
            int(frames.identifier[at]),
            bool(frames.flags[at] & EXTENDED),
            bool(frames.flags[at] & TX),
            frames.payload(at),
        )
        for at in range(len(frames))
    ]


def wanted(frames: list[MadeFrame]) -> list[tuple[int, str, int, bool, bool, bytes]]:
    return [
        (each.at_us, f"can{each.bus}", each.identifier, each.extended, each.sent, each.data)
        for each in frames
    ]


@given(frames=FRAMES, finished=st.booleans())
@settings(max_examples=30, deadline=None)
def test_packed_bits_and_unfinished_files_are_read(frames: list[MadeFrame], finished: bool) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.mf4"
        path.write_bytes(sorted_file(frames, finished=finished, start_ns=START_NS))
        log = read(path)

    assert told(log.frames) == wanted(frames)
    assert log.warnings == ()


@given(frames=FRAMES, block=st.integers(1, 50), long=st.booleans())
@settings(max_examples=30, deadline=None)
def test_records_of_several_groups_are_told_apart(
    frames: list[MadeFrame], block: int, long: bool
) -> None:
    """The data of the frames is in a separate group, and LIN frames stand between them."""
    if long:
        frames = [
            MadeFrame(each.at_us, each.bus, each.identifier, each.extended, each.sent, fd=True,
                      data=each.data.ljust(8, b"\1") * 8)
            for each in frames
        ]  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.mf4"
        path.write_bytes(unsorted_file(frames, start_ns=START_NS))
        source = stream(path, ReadOptions(block_frames=block))
        found = concat(list(source))

    assert sorted(told(found)) == sorted(wanted(frames))
    assert source.warnings == ()
    assert source.skipped == ({"LIN_Frame": len(frames)} if frames else {})
    assert ((found.flags & FD) != 0).tolist() == [long] * len(frames)
    assert not (found.flags & BRS).any()


def test_asammdf_reads_the_files_of_this_test_the_same(tmp_path: Path) -> None:
    """This test makes the files itself, so another program must agree that they are MDF 4."""
    frames = many(50)
    path = tmp_path / "x.mf4"
    path.write_bytes(sorted_file(frames, start_ns=START_NS))

    with asammdf.MDF(str(path)) as file:
        identifiers = file.get("CAN_DataFrame.ID", raw=True)

    assert identifiers.samples.tolist() == [each.identifier for each in frames]
    assert np.rint(identifiers.timestamps * 1e6).tolist() == [each.at_us for each in frames]


@pytest.mark.parametrize("cut", [1, 7, 19, 20, 21, 1000])
@pytest.mark.parametrize("finished", [True, False])
def test_a_torn_file_gives_every_whole_record_and_a_warning(
    tmp_path: Path, cut: int, finished: bool
) -> None:
    frames = many(200)
    path = tmp_path / "x.mf4"
    path.write_bytes(sorted_file(frames, finished=finished, start_ns=START_NS)[:-cut])

    log = read(path)

    whole = (200 * RECORD - cut) // RECORD
    assert told(log.frames) == wanted(frames[:whole])
    # An unfinished file that ends after a record does not show that more records are missing.
    is_noticed = finished or cut % RECORD != 0
    assert [each.kind for each in log.warnings] == (["torn file"] if is_noticed else [])
    if finished:
        assert log.warnings[0].count == 200 - whole


@pytest.mark.parametrize("cut", [1, 7, 20, 40])
def test_a_torn_file_of_several_groups_gives_the_whole_frames(tmp_path: Path, cut: int) -> None:
    frames = many(200)
    path = tmp_path / "x.mf4"
    path.write_bytes(unsorted_file(frames, start_ns=START_NS)[:-cut])

    log = read(path)

    assert 197 <= len(log) < 200 or cut < 10
    assert told(log.frames) == wanted(frames[: len(log)])
    assert "torn file" in {each.kind for each in log.warnings}


def test_the_kernel_and_python_walk_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "x.mf4"
    path.write_bytes(unsorted_file(many(300), start_ns=START_NS)[:-3])
    compiled = read(path)

    monkeypatch.setenv(SWITCH, "off")
    library.cache_clear()
    plain = read(path)
    library.cache_clear()

    assert told(plain.frames) == told(compiled.frames)
    assert plain.warnings == compiled.warnings


def test_a_file_with_broken_links_is_refused_or_read_in_part(tmp_path: Path) -> None:
    whole = sorted_file(many(20), start_ns=START_NS)
    path = tmp_path / "x.mf4"
    path.write_bytes(whole[:64] + bytes(40) + whole[104:])

    with pytest.raises(LogError, match=r"x\.mf4: no usable MDF 4 file: it has no header block"):
        read(path)

    damaged = bytearray(whole)
    damaged[64 + 24 : 64 + 32] = (1 << 40).to_bytes(8, "little")
    path.write_bytes(damaged)
    log = read(path)
    assert len(log) == 0
    assert [each.kind for each in log.warnings] == ["broken link"]
