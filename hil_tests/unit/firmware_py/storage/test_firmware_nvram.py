"""Non-volatile memory: any interruption of a write leaves the old record or the new one."""

import os
import signal
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.storage.nvram import (
    Nvram,
    NvramRecord,
    NvramState,
    decode_record,
    encode_record,
)

OLD = NvramRecord(boot_count=7, wheel_diameter_m=0.853, front_m=1500.25, standing=True)
NEW = NvramRecord(boot_count=8, distance_m=123_456.75, emergency_count=3, highest_term=2**40)
STEPS = ("open", "write", "fsync", "close", "replace")
"""The requests of one write to the operating system."""

RECORDS = st.builds(
    NvramRecord,
    boot_count=st.integers(0, 2**70),
    wheel_diameter_m=st.none() | st.floats(0.5, 1.3),
    front_m=st.none() | st.floats(allow_nan=False, allow_infinity=False),
    standing=st.booleans(),
    distance_m=st.floats(0.0, allow_nan=False, allow_infinity=False),
    emergency_count=st.integers(0, 2**70),
    highest_term=st.integers(0, 2**70),
    train=st.integers(0, 65535),
    line=st.text(),
    database=st.integers(0, 2**64 - 1),
    parameters=st.integers(0, 2**64 - 1),
    software=st.text(),
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file of a memory that holds OLD."""
    file = tmp_path / "vobc.nvram"
    assert Nvram(file).put(OLD)
    return file


class Killed(BaseException):
    """Ends the process at this point; no handler of the program may catch it."""


def before_each_step(
    monkeypatch: pytest.MonkeyPatch, note: Callable[[int, str], None]
) -> Callable[[], None]:
    """Call `note(number, step)` before every request to the system; return a function that ends
    this."""
    number = 0

    def watched(step: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            nonlocal number
            number += 1
            note(number, step)
            return real(*arguments, **options)

        return call

    with_context = monkeypatch.context()
    patch = with_context.__enter__()
    for step in STEPS:
        patch.setattr(os, step, watched(step, getattr(os, step)))

    def undo() -> None:
        with_context.__exit__(None, None, None)

    return undo


@given(RECORDS)
def test_a_record_is_read_back_unchanged(record: NvramRecord) -> None:
    found = decode_record(encode_record(record))

    assert found == record
    assert repr(found) == repr(record)


def test_an_integer_for_a_length_is_read_as_a_float() -> None:
    found = decode_record(encode_record(NvramRecord(front_m=1500, distance_m=0)))

    assert found == NvramRecord(front_m=1500.0, distance_m=0.0)
    assert isinstance(found.front_m, float)


def test_a_stored_record_survives_a_power_cycle(path: Path) -> None:
    memory = Nvram(path)
    assert (memory.state, memory.detail, memory.record) == (NvramState.OK, "", OLD)

    assert memory.put(NEW)

    assert Nvram(path).record == NEW
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_a_record_is_on_the_disk_before_the_name_points_to_it(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[str] = []

    end = before_each_step(monkeypatch, lambda number, step: steps.append(step))
    Nvram(path).put(NEW)
    end()

    assert steps.index("write") < steps.index("fsync") < steps.index("replace")
    assert steps[steps.index("replace") :].count("fsync") == 1


@pytest.mark.parametrize("fatal", range(1, 9))
def test_a_kill_at_any_step_leaves_the_old_or_the_new_record(
    fatal: int, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def kill(number: int, step: str) -> None:
        # The system closes the files of a killed process, so closing goes on.
        if number >= fatal and step != "close":
            raise Killed

    memory = Nvram(path)
    end = before_each_step(monkeypatch, kill)
    died = False
    try:
        memory.put(NEW)
    except Killed:
        died = True
    end()
    after = Nvram(path)

    assert died == (fatal <= 7)
    assert after.state is NvramState.OK
    assert after.record == (OLD if fatal <= 5 else NEW)
    assert after.put(OLD)
    assert Nvram(path).record == OLD


@pytest.mark.parametrize("failing", range(1, 9))
def test_a_disk_failure_at_any_step_is_counted_and_never_raised(
    failing: int, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(number: int, step: str) -> None:
        if number == failing:
            raise OSError(28, "No space left on device")

    memory = Nvram(path)
    end = before_each_step(monkeypatch, fail)
    stored = memory.put(NEW)
    end()

    assert not stored
    assert memory.record == NEW
    assert memory.failed_writes == 1
    assert memory.error == f"{path}: cannot be written: No space left on device"
    assert Nvram(path).record == (OLD if failing <= 5 else NEW)
    assert memory.put(NEW)
    assert Nvram(path).record == NEW


def test_a_real_kill_during_a_write_loses_no_confirmed_record(tmp_path: Path) -> None:
    """A process stores ever higher terms and prints each stored one; then it gets SIGKILL."""
    path = tmp_path / "vobc.nvram"
    program = f"""
from firmware_py.storage.nvram import Nvram, NvramRecord
memory = Nvram({str(path)!r})
for term in range(1_000_000):
    assert memory.put(NvramRecord(highest_term=term))
    print(term, flush=True)
"""
    for lines in (1, 20, 90):
        with subprocess.Popen(
            [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True
        ) as writer:
            assert writer.stdout is not None
            promised = [int(writer.stdout.readline()) for _ in range(lines)]
            writer.send_signal(signal.SIGKILL)
            promised += [int(line) for line in writer.stdout.read().splitlines()]

        found = Nvram(path)
        assert found.state is NvramState.OK
        assert found.record.highest_term in (promised[-1], promised[-1] + 1)


def test_every_single_flipped_bit_is_detected() -> None:
    stored = encode_record(OLD)

    for place in range(len(stored) * 8):
        flipped = bytearray(stored)
        flipped[place // 8] ^= 1 << place % 8
        with pytest.raises(ValueError, match="CRC-32"):
            decode_record(bytes(flipped))


def test_every_truncation_is_detected(path: Path) -> None:
    stored = path.read_bytes()

    for length in range(len(stored)):
        path.write_bytes(stored[:length])
        found = Nvram(path)
        assert found.state is NvramState.CORRUPT
        assert found.record == NvramRecord()
        assert str(path) in found.detail
    path.write_bytes(stored + b"x")
    assert Nvram(path).state is NvramState.CORRUPT


@given(st.binary(max_size=300))
def test_no_garbage_is_a_record_or_a_crash(garbage: bytes) -> None:
    with pytest.raises(ValueError, match="CRC-32"):
        decode_record(garbage)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda text: text.replace('"version": 2', '"version": 1'), "version"),
        (lambda text: text.replace('"line": ""', '"line": 5'), "line: 5"),
        (lambda text: text.replace('"boot_count": 7, ', ""), "holds"),
        (lambda text: text.replace("{", '{"colour": 1, '), "colour"),
        (lambda text: text.replace('"boot_count": 7', '"boot_count": 7.0'), "boot_count: 7.0"),
        (lambda text: text.replace('"boot_count": 7', '"boot_count": true'), "boot_count: True"),
        (lambda text: text.replace('"boot_count": 7', '"boot_count": -7'), "negative"),
        (lambda text: text.replace('"standing": true', '"standing": 1'), "standing: 1"),
        (lambda text: text.replace("0.853", "8.53"), "no wheel"),
        (lambda text: text.replace("0.853", "true"), "wheel_diameter_m: True"),
        (lambda text: text.replace("1500.25", "NaN"), "not finite"),
        (lambda text: text.replace("1500.25", '"far"'), "front_m: 'far'"),
        (lambda text: text.replace('"distance_m": 0.0', '"distance_m": null'), "distance_m: None"),
        (
            lambda text: text.replace('"distance_m": 0.0', '"distance_m": 1' + "0" * 400),
            "too large",
        ),
        (lambda text: "[1, 2]", "version"),
        (lambda text: "[" * 100_000, ""),
    ],
)
def test_foreign_content_with_a_correct_crc_counts_as_corrupt(
    change: Callable[[str], str], why: str, path: Path
) -> None:
    text = path.read_text().splitlines()[0]
    changed = (change(text) + "\n").encode()
    assert changed != (text + "\n").encode()
    path.write_bytes(changed + b"crc32 %08X\n" % zlib.crc32(changed))

    found = Nvram(path)

    assert found.state is NvramState.CORRUPT
    assert why in found.detail
    assert found.record == NvramRecord()


def test_absent_and_unreadable_files_are_distinguished(tmp_path: Path) -> None:
    absent, folder = Nvram(tmp_path / "none"), Nvram(tmp_path)

    assert (absent.state, absent.record) == (NvramState.ABSENT, NvramRecord())
    assert "no such file" in absent.detail
    assert (folder.state, folder.record) == (NvramState.CORRUPT, NvramRecord())
    assert "Is a directory" in folder.detail
    assert not folder.put(NEW)
    assert not Nvram(tmp_path / "no" / "folder").put(NEW)


def test_without_a_readable_record_the_initial_one_is_used(path: Path) -> None:
    assert Nvram(path, initial=NEW).record == OLD
    assert Nvram(path.with_name("none"), initial=NEW).record == NEW
    assert Nvram(None, initial=NEW).record == NEW


def test_a_memory_without_a_file_behaves_the_same_except_for_a_power_cycle() -> None:
    memory = Nvram(None)
    assert (memory.state, memory.record) == (NvramState.ABSENT, NvramRecord())

    assert memory.put(OLD)
    memory.put_later(NEW)
    memory.close()

    assert memory.record == NEW
    assert memory.failed_writes == 0


def test_a_deferred_record_is_on_the_disk_after_closing(path: Path) -> None:
    memory = Nvram(path)
    for count in range(100):
        memory.put_later(NvramRecord(boot_count=count))
        assert memory.record.boot_count == count
    memory.close()

    assert Nvram(path).record.boot_count == 99

    memory.put_later(NEW)
    assert Nvram(path).record == NEW


@pytest.mark.parametrize("repetition", range(20))
def test_an_immediate_record_overrides_a_deferred_one(path: Path, repetition: int) -> None:
    memory = Nvram(path)
    memory.put_later(OLD)
    memory.put(NEW)
    memory.close()

    assert Nvram(path).record == NEW


def test_a_failed_deferred_write_is_counted(tmp_path: Path) -> None:
    memory = Nvram(tmp_path / "no" / "folder")
    memory.put_later(NEW)
    memory.close()

    assert memory.failed_writes == 1
    assert memory.record == NEW


@pytest.mark.parametrize(
    "values",
    [
        {"boot_count": -1},
        {"highest_term": -1},
        {"emergency_count": -1},
        {"wheel_diameter_m": 0.49},
        {"wheel_diameter_m": 1.31},
        {"wheel_diameter_m": float("nan")},
        {"front_m": float("inf")},
        {"front_m": float("nan")},
        {"distance_m": -0.1},
        {"distance_m": float("inf")},
        {"distance_m": float("nan")},
    ],
)
def test_an_impossible_record_is_refused_by_name_and_value(values: dict[str, Any]) -> None:
    (name, value), *_ = values.items()

    with pytest.raises(ValueError, match=name) as caught:
        NvramRecord(**values)

    assert str(value) in str(caught.value)
