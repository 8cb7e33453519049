"""The generated code of controllers and the codec agree on every frame and every damage."""

import ctypes
import math
import random
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from can_dbc import c_source, derived, python_source, wire
from can_dbc.binding import Binding, MessageProtection, binding_of
from can_dbc.brake import BrakeCommand
from can_dbc.codec import Decoder, EncodeError, Encoder, Rejected
from hil_tests.native_rig import code_in
from hil_tests.wire_traffic import damaged, sampled_frame
from hil_tests.wire_verdicts import VERDICTS

pytestmark = pytest.mark.usefixtures("c_compiler")

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror"]
STEPS = 60
SHIPPED = c_source.shipped_bindings()
FOREIGN = """VERSION ""
BU_: ECU
BO_ 2566844926 FAR: 8 ECU
 SG_ level : 0|7@1- (0.5,3) [0|0] "%" ECU
 SG_ state : 8|2@1+ (1,0) [0|2] "" ECU
 SG_ sparse : 10|6@1+ (1,0) [0|63] "" ECU
 SG_ flag : 16|1@1+ (1,0) [0|1] "" ECU
 SG_ odd : 17|33@1+ (1,-5) [-5|8589934586] "" ECU
BO_ 32 GUARDED: 4 ECU
 SG_ permitted : 0|2@1+ (1,0) [0|3] "" ECU
 SG_ count : 2|6@1+ (1,0) [0|40] "" ECU
 SG_ alive_counter : 8|8@1+ (1,0) [0|255] "" ECU
 SG_ crc16 : 16|16@1+ (1,0) [0|65535] "" ECU
BA_DEF_ BO_ "GenMsgSendType" ENUM "cyclic","spontaneous";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "TimeoutMs" INT 0 65535;
BA_DEF_ BO_ "Protection" ENUM "NONE","SAFETY","VITAL";
BA_DEF_ BO_ "SafetyDataId" INT 0 65535;
BA_DEF_DEF_ "GenMsgSendType" "cyclic";
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "TimeoutMs" 0;
BA_DEF_DEF_ "Protection" "NONE";
BA_DEF_DEF_ "SafetyDataId" 0;
BA_ "GenMsgCycleTime" BO_ 32 20;
BA_ "Protection" BO_ 32 1;
BA_ "SafetyDataId" BO_ 32 4660;
VAL_ 2566844926 state 0 "Off" 1 "On" 2 "On" ;
VAL_ 2566844926 sparse 63 "not available" ;
VAL_ 32 permitted 1 "FALSE" 2 "TRUE" ;
"""
"""A foreign bus: no ranges, half-filled tables, 29 bits, one guarded message."""


class Frame(ctypes.Structure):
    _fields_ = [("id", ctypes.c_uint32), ("length", ctypes.c_uint8), ("data", ctypes.c_uint8 * 8)]


class Field(ctypes.Structure):
    _fields_ = [("name", ctypes.c_char_p), ("kind", ctypes.c_int), ("offset", ctypes.c_size_t)]


class Message(ctypes.Structure):
    _fields_ = [
        ("name", ctypes.c_char_p),
        ("id", ctypes.c_uint32),
        ("twin_id", ctypes.c_uint32),
        ("length", ctypes.c_uint8),
        ("protection", ctypes.c_int),
        ("crc", ctypes.c_uint16),
        ("twin_crc", ctypes.c_uint16),
        ("period_ns", ctypes.c_int64),
        ("timeout_ns", ctypes.c_int64),
        ("size", ctypes.c_size_t),
        ("count", ctypes.c_size_t),
        ("fields", ctypes.POINTER(Field)),
        ("pack", ctypes.c_void_p),
        ("unpack", ctypes.c_void_p),
    ]


TYPES: Sequence[type[Any]] = (ctypes.c_double, ctypes.c_int64, ctypes.c_bool, ctypes.c_uint16)
"""Type of a value in C for each wire_kind."""


class Library:
    """The generated files as a shared library, called as a controller in C calls them."""

    def __init__(self, folder: Path, compiler: str, bound: list[Binding]) -> None:
        for name, text in c_source.wire_files(bound).items():
            (folder / name).write_text(text)
        path = folder / "wire.so"
        flags = [*STRICT, "-ffp-contract=off", "-O0", "-shared", "-fPIC"]
        subprocess.run([compiler, *flags, folder / "wire.c", "-o", path], check=True)
        self._code = ctypes.CDLL(str(path))
        self._code.wire_find.restype = ctypes.POINTER(Message)
        self._code.wire_encode.restype = ctypes.c_size_t

    def message(self, can_id: int) -> Any:
        return self._code.wire_find(ctypes.c_uint32(can_id)).contents

    def encode(self, message: Any, sender: Any, frame: Any) -> list[tuple[int, bytes]]:
        room = ctypes.create_string_buffer(message.size)
        for field in message.fields[: message.count]:
            value = getattr(frame, field.name.decode())
            TYPES[field.kind].from_buffer(room, field.offset).value = value
        frames = (Frame * 2)()
        count = self._code.wire_encode(
            ctypes.byref(message), ctypes.byref(sender), room, ctypes.byref(frames)
        )
        return [(each.id, bytes(each.data[: each.length])) for each in frames[:count]]

    def decode(self, message: Any, receiver: Any, can_id: int, data: bytes, at_ns: int) -> Any:
        """Return the verdict, and the values of an accepted frame by name."""
        room = ctypes.create_string_buffer(message.size)
        frame = Frame(can_id, len(data), (ctypes.c_uint8 * 8)(*data[:8]))
        verdict = self._code.wire_decode(
            *(ctypes.byref(message), receiver, ctypes.byref(frame)),
            *(ctypes.c_int64(at_ns), room),
        )
        values = {
            field.name.decode(): TYPES[field.kind].from_buffer(room, field.offset).value
            for field in message.fields[: message.count]
        }
        assert verdict == 0 or not any(room.raw)
        return verdict, values


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory, c_compiler: str) -> Library:
    return Library(tmp_path_factory.mktemp("wire"), c_compiler, SHIPPED)


def receiver() -> Any:
    return ctypes.create_string_buffer(256)


def as_numbers(frame: Any) -> dict[str, Any]:
    fields = binding_of(type(frame)).fields
    return {each.name: getattr(frame, each.name) for each in fields}


def check_sending(library: Library, bound: Binding, bits: random.Random) -> None:
    message, sender = library.message(c_source.wire_id(bound.message)), ctypes.c_uint8(0)
    encoder = Encoder([bound.kind])
    for _ in range(STEPS):
        frame = sampled_frame(bound.kind, bits)
        expected = [
            (c_source.wire_id(each), data)
            for each, (_, data) in zip(bound.messages, encoder.encode(frame), strict=True)
        ]
        assert library.encode(message, sender, frame) == expected, frame


def check_receiving(library: Library, bound: Binding, bits: random.Random) -> None:
    message, state = library.message(c_source.wire_id(bound.message)), receiver()
    wire_ids = {each.frame_id: c_source.wire_id(each) for each in bound.messages}
    decoder = Decoder([bound.kind])
    for can_id, data, at_ns in damaged(bound.kind, bits, STEPS):
        if len(data) > 8:
            continue  # No classic frame.
        expected = decoder.decode(can_id, data, at_ns)
        verdict, values = library.decode(message, state, wire_ids[can_id], data, at_ns)
        if isinstance(expected, Rejected):
            assert VERDICTS[verdict] is expected.reason, (can_id, data.hex())
        elif expected is None:
            assert verdict == 1
        else:
            assert verdict == 0
            assert values == as_numbers(expected)
    assert decoder.rejections


def python_wire(bound: list[Binding]) -> ModuleType:
    """Run the generated Python as a module of its own."""
    module = ModuleType("generated_wire")
    sys.modules[module.__name__] = module
    exec(python_source.wire_files(bound)["wire.py"], module.__dict__)  # noqa: S102 - our own text
    return module


def check_python(wire: Any, bound: Binding) -> None:
    message = wire.MESSAGES[bound.message.name]
    sender, receiver = wire.Sender(message), wire.Receiver(message)
    encoder, decoder = Encoder([bound.kind]), Decoder([bound.kind])
    wire_ids = {each.frame_id: c_source.wire_id(each) for each in bound.messages}
    bits = random.Random(5)
    for _ in range(STEPS // 2):
        frame = sampled_frame(bound.kind, bits)
        expected = [(wire_ids[can_id], data) for can_id, data in encoder.encode(frame)]
        assert sender.send(**as_numbers(frame)) == expected, frame
    for can_id, data, at_ns in damaged(bound.kind, bits, STEPS):
        found = receiver.receive(wire_ids[can_id], data, at_ns)
        wanted = decoder.decode(can_id, data, at_ns)
        if isinstance(wanted, Rejected):
            assert VERDICTS[found] is wanted.reason, (can_id, data.hex())
        else:
            assert found == (1 if wanted is None else 0)
            assert wanted is None or receiver.values == as_numbers(wanted)
    assert receiver.lost == decoder.lost[bound.message.frame_id]


def test_the_generated_python_agrees_on_every_frame_and_damage(tmp_path: Path) -> None:
    (tmp_path / "foreign.dbc").write_text(FOREIGN)
    with code_in("Python"):
        for bound in (SHIPPED, derived.bindings([tmp_path / "foreign.dbc"])):
            generated = python_wire(bound)
            for each in bound:
                check_python(generated, each)


@pytest.mark.parametrize("bound", SHIPPED, ids=lambda bound: bound.message.name)
def test_every_frame_is_sent_and_judged_alike(library: Library, bound: Binding) -> None:
    with code_in("Python"):
        check_sending(library, bound, random.Random(1))
        check_receiving(library, bound, random.Random(2))


def test_the_same_holds_for_a_file_of_another_bus(tmp_path: Path, c_compiler: str) -> None:
    (tmp_path / "foreign.dbc").write_text(FOREIGN)
    bound = derived.bindings([tmp_path / "foreign.dbc"])

    library = Library(tmp_path, c_compiler, bound)

    assert {each.protection for each in bound} == {MessageProtection.NONE, MessageProtection.SAFETY}
    assert library.message(0x18FEF1FE | 1 << 31).name == b"FAR"
    for each in bound:
        check_sending(library, each, random.Random(3))
        check_receiving(library, each, random.Random(4))


def test_a_value_that_is_no_number_is_not_sent_and_not_counted(library: Library) -> None:
    message, sender = library.message(0x101), ctypes.c_uint8(7)
    nan = BrakeCommand(math.nan, emergency_released=True, holding_released=True)

    assert library.encode(message, sender, nan) == []
    assert sender.value == 7
    with pytest.raises(EncodeError):
        Encoder().encode(nan)


def test_what_cannot_be_generated_is_named_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "foreign.dbc"
    path.write_text(FOREIGN.replace('BA_ "SafetyDataId" BO_ 32 4660;\n', ""))

    assert wire.main([str(path), "-o", str(tmp_path / "out")]) == 2
    assert wire.main([str(tmp_path / "none.dbc")]) == 2

    first, second = capsys.readouterr().err.splitlines()
    assert "GUARDED: is protected without a SafetyDataId; give it one" in first
    assert "none.dbc: cannot be read: No such file" in second
    assert not (tmp_path / "out").exists()
