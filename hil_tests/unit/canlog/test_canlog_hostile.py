"""Whatever a file contains, each reader ends, reports the damage, and invents no frame."""

import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from canlog import Log, LogError, ReadOptions, read
from canlog.damage import Damages
from canlog.drawn import drawn_frames
from canlog.formats.registry import FORMATS, named

HOSTILE = settings(
    max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
CHEAP = [each.name for each in FORMATS if each.writes and each.name != "mf4"]


class Logs(dict[str, bytes]):
    """Logs by format; a failing test prints only the names."""

    def __repr__(self) -> str:
        return f"Logs({', '.join(self)})"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Logs:
    """Return a good log in each format."""
    folder, frames = tmp_path_factory.mktemp("whole"), drawn_frames(21, 400)
    found = Logs()
    for each in FORMATS:
        if not each.writes:
            continue
        path = folder / f"x{each.suffixes[0]}"
        each.write(path, [frames], Damages())
        found[each.name] = path.read_bytes()
    return found


def attempt(folder: Path, form: str, data: bytes, *, compiled: bool = True) -> Log | None:
    """Return the log, or None if the reader refuses the file with a message; any other error
    fails.
    """
    path = folder / f"y{named(form).suffixes[0]}"
    path.write_bytes(data)
    try:
        log = read(path, options=ReadOptions(format=form, compiled=compiled))
    except LogError as error:
        said = str(error)
    else:
        return checked(log)
    assert str(path) in said
    return None


def checked(log: Log) -> Log:
    """Check the invariants of a log, and return it."""
    frames = log.frames
    assert frames.data.shape[1] in (8, 64)
    assert len(frames) == 0 or int(frames.length.max()) <= 64
    assert len(frames) == 0 or int(frames.channel.max()) < len(frames.channels)
    assert ((frames.identifier <= 0x7FF) | ((frames.flags & 5) != 0)).all()
    for name in log.messages:
        table = log.table(name)
        for signal in table.names:
            assert len(table[signal]) == len(table)
    return log


def hurt(data: bytes, seed: int) -> bytes:
    """Change, remove or duplicate bytes, or cut off the end."""
    draw, found = random.Random(seed), bytearray(data)
    for _ in range(draw.randrange(1, 6)):
        if not found:
            break
        at, size = draw.randrange(len(found)), draw.choice([1, 1, 1, 4, 40])
        kind = draw.randrange(5)
        if kind <= 1:
            found[at : at + size] = draw.randbytes(min(size, len(found) - at))
        elif kind == 2:
            del found[at : at + size]
        elif kind == 3:
            found[at:at] = found[at : at + size]
        else:
            del found[at:]
    return bytes(found)


@pytest.mark.parametrize("form", CHEAP)
@HOSTILE
@given(seed=st.integers(0, 1 << 32), compiled=st.booleans())
def test_a_damaged_log_is_read_or_refused(
    tmp_path: Path, whole: Logs, form: str, seed: int, compiled: bool
) -> None:
    attempt(tmp_path, form, hurt(whole[form], seed), compiled=compiled)


@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_mf4_is_read_or_refused(tmp_path: Path, whole: Logs, seed: int) -> None:
    attempt(tmp_path, "mf4", hurt(whole["mf4"], seed))


@pytest.mark.parametrize("form", CHEAP)
@HOSTILE
@given(data=st.binary(max_size=300))
def test_any_bytes_behind_the_head_are_read_or_refused(
    tmp_path: Path, whole: Logs, form: str, data: bytes
) -> None:
    attempt(tmp_path, form, whole[form][:150] + data)
    attempt(tmp_path, form, data)


@pytest.mark.parametrize("form", ["candump", "asc", "trc", "blf"])
@HOSTILE
@given(cut=st.floats(0.0, 1.0))
def test_a_log_cut_off_anywhere_gives_a_beginning_of_its_frames(
    tmp_path: Path, whole: Logs, form: str, cut: float
) -> None:
    data = whole[form]
    frames = attempt(tmp_path, form, data)
    short = attempt(tmp_path, form, data[: round(cut * len(data))])

    if short is not None and frames is not None:
        found, n = short.frames, len(short.frames)
        if form in ("asc", "trc") and found.at_ns.tolist() != frames.frames.at_ns[:n].tolist():
            # The head itself is torn, so the start time is unknown.
            assert n == 0
        assert found.at_ns.tolist() == frames.frames.at_ns[:n].tolist()
        assert [found.payload(at) for at in range(n)] == [
            frames.frames.payload(at) for at in range(n)
        ]
        assert (
            n == len(frames.frames)
            or short.warnings
            or cut in (0.0, 1.0)
            or n == 0
            or (data[: round(cut * len(data))].endswith(b"\n"))
        )


@HOSTILE
@given(seed=st.integers(0, 1 << 32))
def test_damage_to_one_line_costs_no_other(tmp_path: Path, whole: Logs, seed: int) -> None:
    draw = random.Random(seed)
    lines = whole["candump"].split(b"\n")[:-1]
    at = draw.randrange(len(lines))
    line = bytearray(lines[at])
    line[draw.randrange(len(line))] = draw.choice(b"#(). \x00Gz\xff")
    before = attempt(tmp_path, "candump", b"\n".join(lines) + b"\n")

    lines[at] = bytes(line)
    after = attempt(tmp_path, "candump", b"\n".join(lines) + b"\n")

    assert before is not None
    assert after is not None
    assert len(before) - 1 <= len(after) <= len(before)
    rest = np.delete(np.arange(len(before)), at)
    others = np.delete(np.arange(len(after)), at) if len(after) == len(before) else slice(None)
    assert after.frames.at_ns[others].tolist() == before.frames.at_ns[rest].tolist()
    if len(after) < len(before):
        assert [each.places for each in after.warnings] == [(at + 1,)]


def test_a_file_that_only_begins_as_mf4_is_refused_in_a_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.mf4"
    path.write_bytes(b"MDF     4.10    nonsense")

    with pytest.raises(LogError, match=r"x\.mf4: no usable MDF 4 file"):
        read(path)

    assert "Traceback" not in capfd.readouterr().err
