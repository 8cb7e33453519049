"""The compiled codec against independent ones: cantools for every bit, crccheck for every CRC."""

import dataclasses
import enum
import math
import typing
from typing import Any

import pytest
from cantools.database.can import Message, Signal
from crccheck.crc import Crc16CcittFalse
from hypothesis import given, settings
from hypothesis import strategies as st

from can_dbc import binding
from can_dbc.codec import Decoder, Encoder, Reason, Rejected
from hil_tests.parsed_by_cantools import data_id_of, message_of, shipped_database

KINDS = binding.kinds()
PROTECTED = [kind for kind in KINDS if "crc16" in message_of(kind).signal_tree]
VITAL = [kind for kind in KINDS if binding.is_vital(kind)]


def types_of(kind: type[Any]) -> dict[str, type[Any]]:
    hints = typing.get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


TYPES: dict[type[Any], dict[str, type[Any]]] = {kind: types_of(kind) for kind in KINDS}


def values_for(kind: type[Any], name: str, annotation: type[Any]) -> st.SearchStrategy[Any]:
    """Values of one field: mostly in its range, sometimes any value of its type."""
    signal = message_of(kind).get_signal_by_name(name)
    if annotation is bool:
        return st.booleans()
    if issubclass(annotation, enum.Flag):
        return st.integers(0, 2**signal.length - 1).map(annotation)
    if issubclass(annotation, enum.Enum):
        return st.sampled_from(annotation)
    if annotation is int:
        return st.integers(-(2**70), 2**70) | st.integers(*map(int, limits(signal)))
    return st.floats(allow_nan=False) | st.floats(*limits(signal))


def limits(signal: Signal) -> tuple[float, float]:
    assert signal.minimum is not None
    assert signal.maximum is not None
    return signal.minimum, signal.maximum


def decoded(message: Message, data: bytes, *, names: bool = True) -> dict[str, Any]:
    """The values that cantools decodes; choices by name or as raw values."""
    found = message.decode(data, decode_choices=names)
    assert isinstance(found, dict)
    return found


def frames_of(kind: type[Any]) -> st.SearchStrategy[Any]:
    return st.builds(
        kind, **{name: values_for(kind, name, each) for name, each in TYPES[kind].items()}
    )


FRAMES: dict[type[Any], st.SearchStrategy[Any]] = {kind: frames_of(kind) for kind in KINDS}


def wire_values(kind: type[Any], frame: Any) -> dict[str, Any]:
    """The values that cantools needs to encode the frame: saturated, with choices as raw values."""
    wire: dict[str, Any] = {}
    for name, annotation in TYPES[kind].items():
        signal = message_of(kind).get_signal_by_name(name)
        value = getattr(frame, name)
        if annotation is bool:
            wire[name] = str(value).upper()
        elif issubclass(annotation, enum.Enum):
            wire[name] = value.value
        else:
            low, high = limits(signal)
            wire[name] = min(max(value, low), high)
    return wire


def with_trailer(message: Message, values: dict[str, Any], data: bytes) -> dict[str, Any]:
    """Add the counter and CRC of `data`, because cantools treats them like any other signal."""
    found = decoded(message, data, names=False)
    return values | {name: found[name] for name in ("alive_counter", "crc16") if name in found}


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=50)
@given(data=st.data())
def test_cantools_encodes_the_same_bits(kind: type[Any], data: st.DataObject) -> None:
    frame = data.draw(FRAMES[kind])
    message = message_of(kind)

    can_id, payload = Encoder().encode(frame)[0]

    assert can_id == message.frame_id
    assert payload == message.encode(with_trailer(message, wire_values(kind, frame), payload))


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=50)
@given(data=st.data())
def test_cantools_and_the_decoder_read_the_same_values(
    kind: type[Any], data: st.DataObject
) -> None:
    message = message_of(kind)
    sent = Encoder().encode(data.draw(FRAMES[kind]))
    decoder = Decoder([kind])

    read = [decoder.decode(can_id, payload, 0) for can_id, payload in sent][-1]

    assert type(read) is kind
    theirs = decoded(message, sent[0][1])
    for name, annotation in TYPES[kind].items():
        value = getattr(read, name)
        assert type(value) is annotation
        if annotation is bool:
            assert theirs[name] == str(value).upper()
        elif issubclass(annotation, enum.Enum):
            assert decoded(message, sent[0][1], names=False)[name] == value.value
        else:
            assert theirs[name] == value


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=50)
@given(data=st.data())
def test_a_decoded_frame_is_encoded_into_its_original_bits(
    kind: type[Any], data: st.DataObject
) -> None:
    sent = Encoder().encode(data.draw(FRAMES[kind]))
    decoder = Decoder([kind])
    read = [decoder.decode(can_id, payload, 0) for can_id, payload in sent][-1]
    assert not isinstance(read, Rejected)
    assert read is not None

    assert Encoder().encode(read) == sent


@pytest.mark.parametrize("kind", VITAL)
@settings(max_examples=50)
@given(data=st.data())
def test_the_twin_is_inverted_and_shows_the_same_values(
    kind: type[Any], data: st.DataObject
) -> None:
    """The payload bits of the twin are inverted, and cantools still decodes the same values."""
    twin = shipped_database().get_message_by_name(binding.message(kind).name + "_INV")

    (_, first), (twin_id, second) = Encoder().encode(data.draw(FRAMES[kind]))

    assert twin_id == twin.frame_id == binding.can_id(kind) + 1
    assert bytes(0xFF - byte for byte in first[:-3]) == second[:-3]
    assert first[-3] == second[-3]
    ours, theirs = decoded(message_of(kind), first), decoded(twin, second)
    for name in TYPES[kind]:
        if isinstance(ours[name], int | float):
            assert theirs[name] == pytest.approx(ours[name], abs=1e-9)
        else:
            assert str(theirs[name]) == str(ours[name])
    assert twin.encode(theirs) == second


@pytest.mark.parametrize("kind", PROTECTED)
@given(data=st.data(), repeats=st.integers(1, 300))
def test_counter_and_crc_are_those_of_an_independent_calculation(
    kind: type[Any], data: st.DataObject, repeats: int
) -> None:
    frame = data.draw(FRAMES[kind])
    encoder = Encoder()

    for _ in range(repeats):
        sent = encoder.encode(frame)

    for message, (_, payload) in zip(binding.binding_of(kind).messages, sent, strict=True):
        body = data_id_of(message.name) + payload[:-2]
        assert payload[-3] == (repeats - 1) % 256
        assert int.from_bytes(payload[-2:], "little") == Crc16CcittFalse.calc(body)


@pytest.mark.parametrize("kind", KINDS)
def test_infinity_is_sent_as_the_end_of_the_range(kind: type[Any]) -> None:
    for name, annotation in TYPES[kind].items():
        if annotation is float:
            signal = message_of(kind).get_signal_by_name(name)
            for value, end in ((math.inf, signal.maximum), (-math.inf, signal.minimum)):
                frame = dataclasses.replace(some_frame(kind), **{name: value})

                sent = Encoder().encode(frame)

                theirs = decoded(message_of(kind), sent[0][1])
                assert theirs[name] == pytest.approx(end)


def some_frame(kind: type[Any]) -> Any:
    """A frame of zeros, false and the first member of every enumeration."""
    return kind(*(next(iter(each)) if issubclass(each, enum.Enum) else each(0)
                  for each in TYPES[kind].values()))  # fmt: skip


@given(
    frames=st.lists(
        st.tuples(
            st.integers(0, 0x7FF) | st.sampled_from([binding.can_id(kind) for kind in KINDS]),
            st.binary(max_size=8),
            st.integers(0, 10**9),
        )
    )
)
def test_no_input_makes_the_decoder_raise(frames: list[tuple[int, bytes, int]]) -> None:
    decoder = Decoder(KINDS)
    refused = 0

    for can_id, data, heard_ns in frames:
        heard = decoder.decode(can_id, data, heard_ns)
        if isinstance(heard, Rejected):
            refused += 1
            assert (heard.can_id, heard.data) == (can_id, data)
            assert heard.detail
        else:
            assert heard is None or type(heard) in KINDS

    assert decoder.rejections.total() == refused


def crc_of(name: str, body: bytes) -> bytes:
    return int(Crc16CcittFalse.calc(data_id_of(name) + body)).to_bytes(2, "little")


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=50)
@given(data=st.data())
def test_any_payload_with_a_good_trailer_is_a_frame_or_an_invalid_value(
    kind: type[Any], data: st.DataObject
) -> None:
    """The test tries bit patterns of the payload with a correct trailer; cantools judges the
    values."""
    message = message_of(kind)
    guarded = kind in PROTECTED
    payload = data.draw(st.binary(min_size=message.length - 3 * guarded,
                                  max_size=message.length - 3 * guarded))  # fmt: skip
    decoder = Decoder([kind])
    sent = [payload]
    if guarded:
        halves = (payload, bytes(0xFF - byte for byte in payload))
        sent = [
            half + b"\x05" + crc_of(each.name, half + b"\x05")
            for each, half in zip(binding.binding_of(kind).messages, halves, strict=False)
        ]

    heard = [
        decoder.decode(each.frame_id, half, 0)
        for each, half in zip(binding.binding_of(kind).messages, sent, strict=True)
    ][-1]

    if all_valid(kind, decoded(message, sent[0], names=False)):
        assert type(heard) is kind
    else:
        assert isinstance(heard, Rejected)
        assert heard.reason is Reason.INVALID_VALUE
        assert heard.can_id == message.frame_id
        assert heard.data == sent[0]


def all_valid(kind: type[Any], found: dict[str, Any]) -> bool:
    for name, annotation in TYPES[kind].items():
        low, high = limits(message_of(kind).get_signal_by_name(name))
        if annotation is bool or issubclass(annotation, enum.Flag):
            continue
        if issubclass(annotation, enum.Enum):
            if found[name] not in {member.value for member in annotation}:
                return False
        elif not low - 1e-9 <= found[name] <= high + 1e-9:
            return False
    return True
