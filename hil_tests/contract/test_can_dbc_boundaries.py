"""Every field of every frame on both sides of each of its limits, with a correct trailer."""

import enum
from typing import Any

import pytest
from cantools.database.can import Signal
from crccheck.crc import Crc16CcittFalse

from can_dbc import binding
from can_dbc.agreement import field_types
from can_dbc.codec import Decoder, Reason, Rejected
from hil_tests.parsed_by_cantools import data_id_of, message_of

FIELDS = [
    (kind, name, annotation)
    for kind in binding.kinds()
    for name, annotation in field_types(kind).items()
]
BOOLEANS = [each for each in FIELDS if each[2] is bool]
FLAGS = [each for each in FIELDS if issubclass(each[2], enum.Flag)]
CHOICES = [each for each in FIELDS if issubclass(each[2], enum.Enum) and each not in FLAGS]
NUMBERS = [each for each in FIELDS if each[2] in (int, float)]


def heard_with(kind: type[Any], name: str, raw: int) -> Any:
    """The decoder's result for a frame of start values with one field set to raw bits."""
    message = message_of(kind)
    word = 0
    for signal in message.signals:
        if signal.name not in ("alive_counter", "crc16"):
            bits = raw if signal.name == name else int(signal.raw_initial or lowest(signal))
            word |= (bits & (1 << signal.length) - 1) << signal.start
    guarded = "crc16" in message.signal_tree
    payload = word.to_bytes(message.length - 3 * guarded, "little")
    decoder = Decoder([kind])
    found = None
    for number, each in enumerate(binding.binding_of(kind).messages):
        half = payload if number == 0 else bytes(0xFF - byte for byte in payload)
        found = decoder.decode(each.frame_id, sealed(each.name, half) if guarded else half, 0)
    return found


def sealed(name: str, payload: bytes) -> bytes:
    body = payload + b"\x05"
    return body + int(Crc16CcittFalse.calc(data_id_of(name) + body)).to_bytes(2, "little")


def signal_of(kind: type[Any], name: str) -> Signal:
    return message_of(kind).get_signal_by_name(name)


def lowest(signal: Signal) -> int:
    """A raw value that every receiver accepts: the one in the range that is nearest to zero."""
    assert signal.minimum is not None
    assert signal.maximum is not None
    if signal.choices:
        return min(int(raw) for raw in signal.choices)
    least, most = raw_limits(signal)
    return min(max(0, least), most)


def raw_limits(signal: Signal) -> tuple[int, int]:
    assert signal.minimum is not None
    assert signal.maximum is not None
    scale, offset = signal.scale, signal.offset
    return round((signal.minimum - offset) / scale), round((signal.maximum - offset) / scale)


def refused(heard: Any) -> bool:
    return isinstance(heard, Rejected) and heard.reason is Reason.INVALID_VALUE


@pytest.mark.parametrize(("kind", "name", "annotation"), BOOLEANS)
def test_only_one_pattern_of_a_boolean_is_permissive(
    kind: type[Any], name: str, annotation: type[Any]
) -> None:
    length = signal_of(kind, name).length

    found = {raw for raw in range(1 << length) if getattr(heard_with(kind, name, raw), name)}

    assert found == ({0b10} if length == 2 else {1})
    assert annotation is bool


@pytest.mark.parametrize(("kind", "name", "annotation"), CHOICES)
def test_a_choice_is_one_of_its_table_or_refused(
    kind: type[Any], name: str, annotation: type[enum.Enum]
) -> None:
    known = {member.value for member in annotation}
    for raw in range(1 << signal_of(kind, name).length):
        heard = heard_with(kind, name, raw)

        if raw in known:
            assert getattr(heard, name) is annotation(raw)
        else:
            assert refused(heard), raw


@pytest.mark.parametrize(("kind", "name", "annotation"), FLAGS)
def test_every_flag_is_decoded_alone_and_with_all_others(
    kind: type[Any], name: str, annotation: type[enum.IntFlag]
) -> None:
    every = sum(flag.value for flag in annotation)
    for raw in [0, every, *(flag.value for flag in annotation)]:
        assert getattr(heard_with(kind, name, raw), name) == annotation(raw)
    assert every < 1 << signal_of(kind, name).length, "the field is as wide as its flags"


@pytest.mark.parametrize(("kind", "name", "annotation"), NUMBERS)
def test_a_number_is_accepted_up_to_its_limits_and_refused_one_step_beyond(
    kind: type[Any], name: str, annotation: type[Any]
) -> None:
    signal = signal_of(kind, name)
    least, most = raw_limits(signal)
    half = 1 << signal.length - 1
    floor, top = (-half, half - 1) if signal.is_signed else (0, 2 * half - 1)

    for raw in (least, least + 1, most - 1, most):
        value = getattr(heard_with(kind, name, raw), name)
        assert type(value) is annotation
        assert value == pytest.approx(raw * signal.scale + signal.offset, abs=1e-9)
    for raw in (least - 1, most + 1):
        if floor <= raw <= top:
            assert refused(heard_with(kind, name, raw)), raw
