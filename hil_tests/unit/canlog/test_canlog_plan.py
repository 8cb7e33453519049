"""Decoding of whole columns equals cantools' decoding of single frames, and the bits of the DBC."""

import math
import random
import struct
from typing import Any

import cantools.database
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.damage import LogError
from canlog.database import parse_bus
from canlog.drawn import DrawnDbc, bit_order, drawn_dbc
from canlog.frames import EXTENDED, FD
from canlog.plan import DecodingPlan, physical_of
from canlog.rows import from_rows
from canlog.table import Groups, Table

WORDS = 'VERSION ""\nNS_ :\nBS_:\nBU_: A B\n'


def table_of(text: str, payloads: list[bytes], frame_id: int = 0x10, flags: int = 0) -> Table:
    bus = parse_bus(text)
    rows = [(at, frame_id, flags, "c", data) for at, data in enumerate(payloads)]
    (spec,) = bus.messages.values()
    return Groups(from_rows(rows)).table(spec)


def payloads_of(drawn: DrawnDbc, seed: int, count: int) -> list[bytes]:
    draw = random.Random(seed)
    special = [b"\0" * drawn.length, b"\xff" * drawn.length]
    found = [*special, *(draw.randbytes(drawn.length) for _ in range(count))]
    # Small first bytes select multiplexed signals that exist.
    found += [bytes([draw.randrange(4)]) + draw.randbytes(drawn.length - 1) for _ in range(count)]
    return found + [data[: draw.randrange(drawn.length + 1)] for data in found[:count]]


def same(found: Any, wanted: Any) -> bool:
    if isinstance(wanted, float) and math.isnan(wanted):
        return math.isnan(found)
    return bool(found == wanted) and (isinstance(wanted, float) or isinstance(found, int))


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 1 << 40))
def test_every_signal_is_what_cantools_decodes(seed: int) -> None:
    drawn = drawn_dbc(seed)
    database = cantools.database.load_string(drawn.text, "dbc", strict=False)
    assert isinstance(database, cantools.database.Database)
    message = database.get_message_by_name("M")
    payloads = payloads_of(drawn, seed, 6)
    flags = (EXTENDED if drawn.extended else 0) | (FD if drawn.length > 8 else 0)

    table = table_of(drawn.text, payloads, drawn.frame_id, flags)

    assert set(table.names) == set(drawn.names)
    assert len(table) == len(payloads)
    undefined = table.undefined
    for at, data in enumerate(payloads):
        try:
            wanted: Any = message.decode(data, decode_choices=False, allow_truncated=True)
        except cantools.database.DecodeError:
            assert undefined[at] or len(data) < drawn.length
            continue
        if len(data) == drawn.length:
            assert not undefined[at]
        # An integer that does not fit into 64 bits becomes the nearest float.
        for name in drawn.names:
            if len(data) == drawn.length or drawn.kind == "plain":
                assert bool(table.valid(name)[at]) == (name in wanted), name
            if name in wanted and table.valid(name)[at]:
                found = table[name][at].item()
                exact = same(found, wanted[name])
                assert exact or nearest_float(table, name, found, wanted[name]), (
                    name,
                    found,
                    wanted[name],
                )


def nearest_float(table: Table, name: str, found: Any, wanted: Any) -> bool:
    """Whether a value is the nearest float, for a signal whose values do not all fit into 64
    bits.
    """
    signal = table.spec.signal(name)
    most = abs(signal.scale) * 2.0**signal.length + abs(signal.offset)
    return most >= 2.0**63 and math.isclose(found, wanted, rel_tol=1e-15)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 1 << 40))
def test_raw_values_are_the_bits_that_the_dbc_names(seed: int) -> None:
    drawn = drawn_dbc(seed)
    payloads = [data for data in payloads_of(drawn, seed, 4) if len(data) == drawn.length]
    table = table_of(
        drawn.text, payloads, drawn.frame_id,
        (EXTENDED if drawn.extended else 0) | (FD if drawn.length > 8 else 0),
    )  # fmt: skip

    for signal in table.spec.signals:
        bits = bit_order(signal.start, signal.length, little=not signal.big_endian)
        bits = bits if signal.big_endian else bits[::-1]
        for data, found in zip(payloads, table.raw(signal.name).tolist(), strict=True):
            text = "".join(str(data[bit // 8] >> bit % 8 & 1) for bit in bits)
            wanted = int(text, 2)
            if signal.signed and text[0] == "1":
                wanted -= 1 << signal.length
            assert found == wanted


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 1 << 40))
def test_the_kernel_and_numpy_give_the_same_values(seed: int) -> None:
    drawn = drawn_dbc(seed)
    payloads = payloads_of(drawn, seed, 4)
    table = table_of(
        drawn.text, payloads, drawn.frame_id,
        (EXTENDED if drawn.extended else 0) | (FD if drawn.length > 8 else 0),
    )  # fmt: skip
    plan = DecodingPlan(table.spec)

    for name in table.names:
        compiled = plan.physical(name, table.payloads)
        plain = physical_of(plan.cuts[name].spec, plan.raw(name, table.payloads))
        assert compiled.dtype == plain.dtype
        assert compiled.tobytes() == plain.tobytes()


def test_numbers_near_two_to_the_64_keep_every_bit() -> None:
    text = WORDS + 'BO_ 16 M: 8 A\n SG_ u : 0|64@1+ (1,0) [0|0] "" B\n'
    values = [0, 1, 2**53 + 1, 2**63 - 1, 2**63, 2**64 - 1]

    table = table_of(text, [value.to_bytes(8, "little") for value in values])

    assert table["u"].dtype == np.uint64
    assert table["u"].tolist() == values


def test_scaled_integers_stay_integers_and_wrap_nowhere() -> None:
    text = WORDS + 'BO_ 16 M: 8 A\n SG_ s : 7|64@0- (1,-5) [0|0] "" B\n'
    payloads = [value.to_bytes(8, "big", signed=True) for value in (0, -1, 2**62, -(2**62))]

    table = table_of(text, payloads)

    assert table["s"].dtype == np.float64  # its range leaves 64 bits
    assert table["s"].tolist() == [-5.0, -6.0, float(2**62 - 5), float(-(2**62) - 5)]


def test_float_signals_are_read_as_floats() -> None:
    text = WORDS + (
        'BO_ 16 M: 8 A\n SG_ f : 0|32@1- (2,1) [0|0] "" B\n SG_ g : 39|32@0- (1,0) [0|0] "" B\n'
        "SIG_VALTYPE_ 16 f : 1;\nSIG_VALTYPE_ 16 g : 1;\n"
    )

    table = table_of(text, [struct.pack("<f", 1.5) + struct.pack(">f", -0.1)])

    assert table["f"].tolist() == [4.0]
    assert table["g"].tolist() == [struct.unpack("f", struct.pack("f", -0.1))[0]]


MUX = WORDS + (
    'BO_ 16 M: 8 A\n SG_ common : 8|8@1+ (1,0) [0|0] "" B\n SG_ which M : 0|8@1+ (1,0) [0|0] "" B\n'
    ' SG_ one m1 : 16|8@1+ (1,0) [0|0] "" B\n SG_ two m2 : 16|8@1+ (0.5,0) [0|0] "" B\n'
)


def test_an_undefined_multiplexer_value_keeps_the_common_signals_and_is_counted() -> None:
    table = table_of(MUX, [bytes([which, 7, 40, 0, 0, 0, 0, 0]) for which in (1, 2, 9)])

    assert table["common"].tolist() == [7, 7, 7]
    assert table.valid("common").all()
    assert table.undefined.tolist() == [False, False, True]
    assert table.valid("one").tolist() == [True, False, False]
    assert table["one"].tolist() == [40, 0, 0]
    assert table["two"][1] == 20.0
    assert np.isnan(table["two"][[0, 2]]).all()


def test_a_short_frame_has_only_the_signals_that_it_holds() -> None:
    table = table_of(MUX, [b"\x01\x07\x28", b"\x01\x07", b"\x01", b""])

    assert table.valid("one").tolist() == [True, False, False, False]
    assert table.valid("common").tolist() == [True, True, False, False]
    assert table["common"].tolist() == [7, 7, 0, 0]


def test_a_frame_longer_than_its_message_is_decoded() -> None:
    text = WORDS + 'BO_ 16 M: 1 A\n SG_ u : 0|8@1+ (1,0) [0|0] "" B\n'

    assert table_of(text, [b"\x05\xff\xff"])["u"].tolist() == [5]


def test_the_arrow_table_has_nulls_units_and_names() -> None:
    arrow = table_of(MUX, [bytes([1, 7, 40]), bytes([9, 7, 40])]).arrow()

    assert arrow.column("at_ns").to_pylist() == [0, 1]
    assert arrow.column("one").to_pylist() == [40, None]
    assert arrow.schema.metadata == {b"message": b"M"}


def test_what_the_dbc_does_not_have_is_an_error_that_names_it() -> None:
    table = table_of(MUX, [b""])

    with pytest.raises(LogError, match="no signal three; it has which, common"):
        table["three"]
    with pytest.raises(LogError, match="did you mean M"):
        parse_bus(MUX).message("MM")
    with pytest.raises(LogError, match=r"bad\.dbc: not a usable DBC file"):
        parse_bus("BO_ what", "bad.dbc")


def test_frames_of_many_identifiers_are_grouped_by_message_in_the_order_of_the_log() -> None:
    draw = random.Random(4)
    rows = [(at, draw.randrange(1 << 29), EXTENDED, "c", b"x") for at in range(300)]
    rows += [(at, draw.randrange(300), 0, "c", b"y") for at in range(300, 900)]
    frames = from_rows(rows)
    groups = Groups(frames)

    found = {key: groups.rows(key).tolist() for key in groups.keys}

    wanted: dict[int, list[int]] = {}
    for at, (_, identifier, flags, _, _) in enumerate(rows):
        wanted.setdefault(identifier | (1 << 31 if flags else 0), []).append(at)
    assert found == wanted
