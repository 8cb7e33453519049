"""The verdicts on whole logs agree frame by frame with the codec that judges on board."""

import dataclasses
import random
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from can_dbc.binding import binding_of, kinds
from can_dbc.codec import Decoder, Encoder, Reason, Rejected
from can_dbc.packing import unpacker
from canlog.frames import ERROR, EXTENDED, REMOTE, Frames
from canlog.rows import from_rows
from canlog.verdict import CODES, Judge, crc16, judge
from canlog.verdict_codes import ACCEPTED, NOT_JUDGED, UNCONFIRMED

Row = tuple[int, int, int, str, bytes]
KINDS = [kind for kind in kinds() if len(dataclasses.fields(kind))]
VITAL = {
    each.message.frame_id: each.twin.frame_id for each in map(binding_of, kinds()) if each.twin
}


def traffic(seed: int, count: int, damaged_share: float) -> list[Row]:
    """Return frames as senders make them, with every fault that a bus can cause."""
    draw = random.Random(seed)
    encoder = Encoder()
    chosen = draw.sample(KINDS, 4)
    now_ns, rows, past = 0, list[Row](), list[tuple[int, int, str, bytes]]()
    while len(rows) < count:
        now_ns += draw.choice([1_000_000, 10_000_000, 50_000_000, 700_000_000])
        kind = draw.choice(chosen)
        bits = draw.getrandbits(64) if draw.random() < 0.3 else 0
        frame = unpacker(kind)(bits & (1 << 8 * binding_of(kind).message.length) - 1)
        if frame is None:
            frame = unpacker(kind)(0)
        if frame is None:
            continue
        for can_id, data in encoder.encode(frame):
            now_ns += draw.choice([300_000, 300_000, 300_000, 25_000_000])
            fault = draw.random()
            if fault > damaged_share:
                rows.append((now_ns, can_id, 0, "c", data))
            elif fault < 0.25 * damaged_share:
                continue
            elif fault < 0.5 * damaged_share:
                at = draw.randrange(len(data)) if data else 0
                wrong = bytes(
                    b ^ (1 << draw.randrange(8) if i == at else 0) for i, b in enumerate(data)
                )
                rows.append((now_ns, can_id, 0, "c", wrong))
            elif fault < 0.6 * damaged_share:
                rows.append((now_ns, can_id, 0, "c", data[: draw.randrange(len(data) + 1)]))
            elif fault < 0.7 * damaged_share:
                rows.append((now_ns, draw.randrange(0x800), 0, "c", data))
            elif fault < 0.8 * damaged_share and past:
                rows.append((now_ns, *draw.choice(past)))
            else:
                rows += [(now_ns, can_id, 0, "c", data)] * 2
            past.append((can_id, 0, "c", data))
    return rows


def oracle(rows: list[Row]) -> tuple[list[int], Decoder]:
    """Return the code of each frame from the codec, one frame at a time."""
    decoder = Decoder(kinds())
    told = [NOT_JUDGED] * len(rows)
    waiting: dict[int, int] = {}
    twins = {twin: first for first, twin in VITAL.items()}
    for at, (at_ns, can_id, flags, _channel, data) in enumerate(rows):
        if flags:
            continue
        verdict = decoder.decode(can_id, data, at_ns)
        first = twins.get(can_id)
        if can_id in VITAL:
            if isinstance(verdict, Rejected) and verdict.reason is not Reason.TWIN_TIMEOUT:
                told[at] = CODES[verdict.reason]
                continue
            if isinstance(verdict, Rejected):
                told[waiting[can_id]] = CODES[verdict.reason]
            told[at] = UNCONFIRMED
            waiting[can_id] = at
        elif isinstance(verdict, Rejected):
            if first is not None and verdict.can_id == first:
                told[waiting[first]], told[at] = CODES[verdict.reason], UNCONFIRMED
            else:
                told[at] = CODES[verdict.reason]
        else:
            told[at] = ACCEPTED
            if first is not None:
                told[waiting[first]] = ACCEPTED
    return told, decoder


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1 << 32), st.sampled_from([0.0, 0.1, 0.5]))
def test_every_frame_is_judged_as_the_codec_judges_it(seed: int, damaged_share: float) -> None:
    rows = traffic(seed, 150, damaged_share)
    wanted, decoder = oracle(rows)

    found = judge(from_rows(rows))

    assert found.code.tolist() == wanted
    assert found.lost == {k: n for k, n in decoder.lost.items() if n}


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 1 << 32), st.integers(1, 60))
def test_a_log_judged_in_blocks_is_judged_as_in_one_piece(seed: int, block: int) -> None:
    frames = from_rows(traffic(seed, 120, 0.4))
    one, code = Judge(), []

    for start in range(0, len(frames), block):
        code += one.feed(frames[start : start + block]).tolist()
        for late in one.late:
            code[late.row] = late.code

    assert code == judge(frames).code.tolist()
    assert {key: count for key, count in one.lost.items() if count} == judge(frames).lost


def test_all_reasons_turn_up_in_the_traffic_that_the_verdicts_are_tested_with() -> None:
    seen = {code for seed in range(40) for code in oracle(traffic(seed, 150, 0.5))[0]}

    assert seen >= {ACCEPTED, UNCONFIRMED, *CODES.values()} - {CODES[Reason.INVALID_VALUE]}


def invalid_frames() -> Iterator[Row]:
    """Return a frame of every unprotected kind, with all bits set."""
    for kind in kinds():
        message = binding_of(kind).message
        if binding_of(kind).protection.value == 0:
            yield 0, message.frame_id, 0, "c", b"\xff" * message.length


def test_values_that_no_class_knows_are_refused_as_the_codec_refuses_them() -> None:
    rows = list(invalid_frames())

    assert judge(from_rows(rows)).code.tolist() == oracle(rows)[0]


def test_channels_have_receivers_of_their_own() -> None:
    rows = traffic(3, 60, 0.2)
    two = [(*row[:3], name, row[4]) for row in rows for name in ("a", "b")]

    found = judge(from_rows(two)).code

    assert found[0::2].tolist() == found[1::2].tolist() == judge(from_rows(rows)).code.tolist()


@pytest.mark.parametrize("flag", [REMOTE, ERROR, EXTENDED])
def test_frames_that_no_receiver_takes_are_not_judged(flag: int) -> None:
    rows = traffic(5, 40, 0.0)
    odd = [row for each in rows for row in (each, (each[0], each[1], flag, "c", each[4]))]

    found = judge(from_rows(odd)).code

    assert set(found[1::2].tolist()) == {NOT_JUDGED}
    assert found[0::2].tolist() == judge(from_rows(rows)).code.tolist()


@settings(max_examples=30, deadline=None)
@given(st.lists(st.binary(min_size=5, max_size=5), min_size=1, max_size=5), st.integers(0, 0xFFFF))
def test_the_crc_of_columns_is_that_of_the_standard_library(rows: list[bytes], start: int) -> None:
    from binascii import crc_hqx

    data = np.frombuffer(b"".join(rows), np.uint8).reshape(-1, 5)

    for length in range(6):
        wanted = [crc_hqx(row[:length], start) for row in rows]
        assert crc16(data[:, :length], start).tolist() == wanted


def test_an_empty_log_has_no_verdicts() -> None:
    empty: Frames = from_rows([])

    assert len(judge(empty).code) == 0
