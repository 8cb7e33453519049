"""The wire and the logs in C do the same as their readable references in Python."""

import dataclasses
import enum
import math
import random
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc import binding, c_source
from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.codec import Decoder, EncodeError, Encoder
from can_dbc.nodes import Direction
from firmware_py.buses.inproc import INBOX_FRAMES, InprocBus, VirtualBus
from firmware_py.buses.timing import frame_bits
from firmware_py.storage import lines
from hil_tests.native_rig import built, code_in
from hil_tests.wire_traffic import damaged, sampled_frame
from metro_hil.campaign.builder import Scenario
from metro_hil.model.run_folder import RunFolder
from metro_hil.run.dispatch import run_case

pytestmark = pytest.mark.usefixtures("c_compiler")

BOUND = [binding.binding_of(kind) for kind in binding.kinds()]
KINDS = list({(each.fields, each.protection): each.kind for each in BOUND}.values())
"""One frame class of each layout."""
STEPS = 400
NODES = ("VOBC", "BCU", "TCU", "DESK")
STRANGE: tuple[Any, ...] = (math.nan, "1", None, True, 1, 10**400, -(10**400), 2**60, Direction)
"""Values that are unusual for a field, and mostly wrong."""


def encoded(encoder: Encoder, frame: Any) -> Any:
    try:
        return encoder.encode(frame)
    except EncodeError as error:
        return str(error)


def in_both(make: Callable[[], Any]) -> tuple[Any, Any]:
    """Create the same thing in Python and in C."""
    with code_in("Python"):
        python = make()
    with code_in("C"):
        return python, make()


@pytest.mark.parametrize("kind", KINDS)
def test_frames_become_the_same_bytes(kind: type[Any]) -> None:
    bits = random.Random(kind.__name__)
    python, c = in_both(lambda: Encoder([kind]))

    for _ in range(STEPS):
        frame = sampled_frame(kind, bits)
        assert encoded(c, frame) == encoded(python, frame), frame


@pytest.mark.parametrize("kind", KINDS)
def test_a_strange_value_ends_the_same_and_leaves_the_counter(kind: type[Any]) -> None:
    bits = random.Random(kind.__name__)
    python, c = in_both(lambda: Encoder([kind]))
    frame = sampled_frame(kind, bits)

    for field in binding.binding_of(kind).fields:
        for value in STRANGE:
            strange = sampled_frame(kind, bits)
            object.__setattr__(strange, field.name, value)
            assert encoded(c, strange) == encoded(python, strange), (field.name, value)
            assert encoded(c, frame) == encoded(python, frame)


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_traffic_gets_the_same_verdicts(kind: type[Any]) -> None:
    bits = random.Random(kind.__name__)
    python, c = in_both(lambda: Decoder([kind]))
    with code_in("Python"):
        traffic = list(damaged(kind, bits))

    for frame in traffic:
        expected, found = python.decode(*frame), c.decode(*frame)
        assert found == expected, frame
        assert type(found) is type(expected)
    assert c.rejections == python.rejections
    assert c.lost == python.lost
    assert len(python.rejections) > 0


def by_the_dataclass(kind: type[Any], *values: Any, **named: Any) -> Any:
    """Create a frame by the constructor of its dataclass, or return the text of the mistake."""
    try:
        return type.__call__(kind, *values, **named)
    except TypeError as error:
        return str(error)


def by_c(kind: type[Any], *values: Any, **named: Any) -> Any:
    try:
        return kind(*values, **named)
    except TypeError as error:
        return str(error)


@pytest.mark.parametrize("kind", KINDS)
def test_c_creates_frames_as_the_dataclass_does(kind: type[Any]) -> None:
    in_both(lambda: Encoder([kind]))
    frame = sampled_frame(kind, random.Random(kind.__name__))
    named = {field.name: getattr(frame, field.name) for field in dataclasses.fields(kind)}
    values = [*named.values()]

    for at in range(len(values) + 1):
        some, others = values[:at], dict([*named.items()][at:])
        assert by_c(kind, *some, **others) == frame
        assert by_c(kind, *some) == by_the_dataclass(kind, *some)
        assert by_c(kind, *some, **{"".join(others): 0}) == by_the_dataclass(
            kind, *some, **{"".join(others): 0}
        )
    assert by_c(kind, *values, 0) == by_the_dataclass(kind, *values, 0)
    assert by_c(kind, values[0], **named) == by_the_dataclass(kind, values[0], **named)
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(kind(*values), next(iter(named)), 0)


def test_the_same_bits_again_are_the_same_object_also_in_c() -> None:
    _, c = in_both(lambda: Decoder([BrakeCommand]))
    encoder = Encoder()
    command = BrakeCommand(1.0, emergency_released=True, holding_released=False)

    heard = [c.decode(*each, 0) for _ in range(2) for each in encoder.encode(command)]

    assert heard == [None, command, None, command]
    assert heard[1] is heard[3]


def test_a_class_of_a_users_file_keeps_pythons_functions() -> None:
    """The compiled functions are those of the shipped files."""
    assert BrakeStatus in c_source.compiled_kinds()
    with code_in("C"), pytest.raises(LookupError):
        built()[0].sender(0x7FE, BrakeStatus, (), None)


def test_the_generated_c_files_are_small_enough_to_read() -> None:
    files = c_source.wire_files(c_source.shipped_bindings())
    lines = [line for text in files.values() for line in text.splitlines()]

    assert len(lines) < 3000
    assert max(map(len, lines)) <= 110


# Logs


def c_number(numbers: list[float]) -> list[str]:
    blocks: list[bytes] = []
    rows = built()[1].CsvLines(lambda block, count: blocks.append(block))
    rows.row((0.0, tuple(numbers)))
    rows.flush()
    return blocks[0].decode()[2:-1].split(" ")


def test_numbers_are_printed_as_python_prints_them() -> None:
    """The sweep has every binary exponent from 2^-40 to 2^60, and ties after nine digits."""
    bits = random.Random(1)
    numbers = [
        sign * math.ldexp(1.0 + mantissa, exponent)
        for exponent in range(-40, 60)
        for mantissa in (0.0, 2.0**-52, 1.0 - 2.0**-52, *(bits.random() for _ in range(60)))
        for sign in (1.0, -1.0)
    ]
    numbers += [(bits.randrange(10**9) + 0.5) / 2.0**k for k in range(30) for _ in range(40)]
    numbers += [bits.randrange(10**10) / 10.0**k for k in range(16) for _ in range(60)]
    numbers += [math.nextafter(10.0**k, to) for k in range(-12, 13) for to in (0.0, 1e99)]
    numbers += [10.0**k for k in range(-12, 13)]
    numbers += [math.inf, -math.inf, math.nan, 0.0, -0.0, 5e-324, 999999999.5, 99999999.95]

    assert c_number(numbers) == [f"{number:.9g}" for number in numbers]


@given(st.floats())
def test_any_number_is_printed_as_python_prints_it(number: float) -> None:
    assert c_number([number]) == [f"{number:.9g}"]


@given(st.integers(0, 2**64 - 1))
def test_any_bits_are_printed_as_python_prints_them(raw: int) -> None:
    (number,) = struct.unpack("<d", raw.to_bytes(8, "little"))

    assert c_number([number]) == [f"{number:.9g}"]


class Shade(enum.Enum):
    DARK_RED = 1


class Marks(enum.Flag):
    ONE = 1
    TWO = 2


VALUES = st.recursive(
    st.one_of(
        *(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8)),
        *(st.sampled_from(Shade), st.sampled_from([Marks.ONE | Marks.TWO, Marks(0), Marks.TWO])),
        st.binary(max_size=4),
    ),
    lambda inner: st.tuples(inner, inner),
    max_leaves=4,
)


@given(st.lists(st.tuples(st.integers(-3, 3).map(lambda n: n / 2), VALUES, VALUES), max_size=8))
def test_rows_are_the_same_lines_in_the_same_blocks(rows: list[tuple[object, ...]]) -> None:
    def written(log: Any) -> list[tuple[bytes, int]]:
        blocks: list[tuple[bytes, int]] = []
        made = log.CsvLines(lambda block, count: blocks.append((block, count)))
        for row in rows:
            made.row(row)
        made.flush()
        return blocks

    assert written(built()[1]) == written(lines)


# The bus


def played(bus: VirtualBus, steps: list[tuple[int, int, str, int, bytes]]) -> list[Any]:
    """Send, receive, connect and disconnect; return everything that can be observed."""
    ports = {name: bus.port(name, None if name == "VOBC" else {0x101, 0x182}) for name in NODES}
    seen: list[Any] = []
    for at_ns, action, node, can_id, data in steps:
        if action == 0 and node != "VOBC":
            ports[node].close()
            seen.append(ports[node].counters)
            if ports[node].name not in bus._ports:
                ports[node] = bus.port(node)
        elif action == 1:
            seen.append((node, list(ports[node].receive(at_ns))))
        elif action == 2:
            bus.advance(at_ns)
        else:
            for _ in range(1 if action < 12 else 300):
                ports[node].send(at_ns, can_id, data)
        seen.append(bus.statistics())
    seen += [(list(port.receive(10**12)), port.counters) for port in ports.values()]
    return [*seen, bus.statistics()]


STEP = st.tuples(
    *(st.integers(0, 12_000_000), st.integers(0, 12), st.sampled_from(NODES)),
    *(st.sampled_from([0x101, 0x102, 0x181, 0x182, 0x700]), st.binary(max_size=8)),
)


@given(st.lists(STEP, max_size=40).map(lambda steps: sorted(steps, key=lambda step: step[0])))
def test_any_traffic_is_the_same_on_both_buses(
    steps: list[tuple[int, int, str, int, bytes]],
) -> None:
    """Offers, full mailboxes, filters, closed ports, receptions, recorder and log lines."""

    def run(make: Any, log: Any) -> list[Any]:
        seen: list[Any] = []
        written = log.CandumpLines(lambda block, count: seen.append((block, count)), "can0")
        bus = make("can0", 250_000, lambda frame, node: seen.append((frame, node)), written)
        seen += played(bus, steps)
        written.flush()
        return seen

    assert run(built()[1].Bus, built()[1]) == run(InprocBus, lines)


@pytest.mark.parametrize("language", ["Python", "C"])
def test_a_full_inbox_counts_the_frames_that_it_drops(language: str) -> None:
    with code_in(language):
        bus = (InprocBus if language == "Python" else built()[1].Bus)("can0", 1_000_000_000)
    sender, hearer = bus.port("one"), bus.port("other")
    for at in range(INBOX_FRAMES + 3):
        sender.send(at * 1000, 0x100, b"")
    bus.advance(10**12)

    assert hearer.counters.dropped_in == 3
    assert len(hearer.receive(10**12)) == INBOX_FRAMES


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_a_frame_is_as_long_in_c(can_id: int, data: bytes) -> None:
    assert built()[1].frame_bits(can_id, data) == frame_bits(can_id, data)


@pytest.mark.parametrize(("can_id", "data"), [(0x800, b""), (-1, b""), (1, bytes(9))])
def test_an_impossible_frame_is_refused_with_the_same_words(can_id: int, data: bytes) -> None:
    found = []
    for make in (InprocBus, built()[1].Bus):
        with pytest.raises(ValueError, match="frame") as caught:
            make("can0", 250_000).port("one").send(0, can_id, data)
        found.append(str(caught.value))

    assert found[0] == found[1]


# A whole run

FAULTS = (
    {
        "kind": "frame_corrupt",
        "damage": "on_wire",
        "share_ratio": 0.2,
        "start_s": 1.0,
        "duration_s": 1.0,
    },
    {"kind": "frame_corrupt", "damage": "after_crc", "start_s": 2.5, "duration_s": 0.5},
    {"kind": "babbling_idiot", "can_id": 0x180, "start_s": 3.5, "duration_s": 0.5},
    {"kind": "link_cut", "start_s": 4.5, "duration_s": 0.3},
    {"kind": "masquerade", "start_s": 5.0, "duration_s": 0.5},
    {"kind": "frame_delay", "delay_s": 0.03, "start_s": 5.5, "duration_s": 0.5},
)


def test_a_run_with_bus_faults_writes_the_same_files(tmp_path: Path) -> None:
    """Seven seconds with one fault after the other: every log byte by byte."""
    train = {"start": "II", "end": "III", "duration_s": 7.0}
    (case,) = Scenario(name="hop", train=train, fault=FAULTS, seeds=1).cases()
    found = []
    for language in ("Python", "C"):
        folder = tmp_path / language
        folder.mkdir()
        with code_in(language):
            result = run_case(case, folder=RunFolder(folder))
        logs = [path for path in sorted(folder.iterdir()) if path.suffix in (".log", ".csv")]
        assert all(fault.touched for fault in result.faults)
        found.append((result.chain, {path.name: path.read_bytes() for path in logs}))

    assert {*found[0][1]} >= {"bus.log", "ports.log", "cycles.csv", "truth.csv", "serial.log"}
    assert found[0] == found[1]


# The C library alone

PROGRAM = """
#include <stdio.h>
#include "wire.h"

int main(void)
{
    const struct BRAKE_CMD sent = {0.75, true, false};
    struct BRAKE_CMD received;
    struct wire_sender sender = {0};
    struct wire_receiver receiver = {0};
    struct wire_frame frames[WIRE_FRAMES_MAX];
    size_t count = wire_send_BRAKE_CMD(&sender, &sent, frames);
    for (size_t half = 0; half < count; half++) {
        for (int at = 0; at < frames[half].length; at++)
            printf("%02x", frames[half].data[at]);
        printf(" ");
    }
    int first = wire_receive_BRAKE_CMD(&receiver, &frames[0], 0, &received);
    int second = wire_receive_BRAKE_CMD(&receiver, &frames[1], 1000, &received);
    printf("%d %d", first, second);
    printf(" %g %d", received.service_decel_mps2, received.emergency_released);
    printf(" %d", wire_is_fresh(wire_find(WIRE_ID_BRAKE_CMD_INV), &receiver, 150001000));
    printf(" %d", wire_is_fresh(wire_find(WIRE_ID_BRAKE_CMD), &receiver, 150001001));
    return 0;
}
"""


def test_a_controller_in_c_can_use_the_generated_files_alone(
    tmp_path: Path, c_compiler: str
) -> None:
    files = {**c_source.sources(), "main.c": PROGRAM.encode()}
    for name in ("wire.h", "wire.c", "main.c"):
        (tmp_path / name).write_bytes(files[name])
    strict = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror"]
    command = [c_compiler, *strict, "-O0", *(str(tmp_path / name) for name in ("main.c", "wire.c"))]
    subprocess.run([*command, "-o", str(tmp_path / "main")], check=True)
    done = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True)

    frame = BrakeCommand(0.75, emergency_released=True, holding_released=False)
    with code_in("Python"):
        halves = [data.hex() for _, data in Encoder().encode(frame)]
    assert done.stdout.split() == [*halves, "1", "0", "0.75", "1", "1", "0"]
