"""The codec's rules for counters, pairs, unknown frames and invalid values."""

import dataclasses
import math
from typing import Any

import pytest

from can_dbc import binding
from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.codec import Decoder, EncodeError, Encoder, Reason, Rejected
from can_dbc.diagnostics import EMERGENCIES, HEARTBEATS, NodeState
from can_dbc.doors import DoorCommand
from can_dbc.energy import LineSupply
from can_dbc.nodes import Direction, Node
from can_dbc.odometer import Doppler, Tacho
from can_dbc.traction import TractionCommand, TractionStatus
from can_dbc.trailer import opener
from can_dbc.vobc import AtoPhase, Missing, Supervision, VobcMotion, VobcStatus
from hil_tests.native_rig import in_both_languages  # noqa: F401

MS = 1_000_000
TACHO_ID = 0x185
BRAKE_ID, BRAKE_TWIN_ID = 0x101, 0x102

TACHO = Tacho(1, 2, Direction.FORWARD, healthy_a=True, healthy_b=False, stamp_ms=0)
RELEASED = BrakeCommand(service_decel_mps2=0.5, emergency_released=True, holding_released=True)
BRAKING = BrakeCommand(service_decel_mps2=1.5, emergency_released=True, holding_released=True)


def with_values(frame: Any, **values: Any) -> Any:
    """A copy with some fields changed, to values of any type."""
    return dataclasses.replace(frame, **values)


def tacho_payloads(count: int) -> list[bytes]:
    """Payloads with the counters 0, 1, 2, ... modulo 256, each with its own pulses."""
    encoder = Encoder()
    return [encoder.encode(with_values(TACHO, pulses_a=number))[0][1] for number in range(count)]


def outcomes(decoder: Decoder, payloads: list[bytes], period_ms: int = 20) -> list[Reason | None]:
    """The rejection reason of each payload, or None for an accepted frame."""
    found: list[Reason | None] = []
    for number, payload in enumerate(payloads):
        heard = decoder.decode(TACHO_ID, payload, number * period_ms * MS)
        found.append(heard.reason if isinstance(heard, Rejected) else None)
        assert isinstance(heard, Rejected | Tacho)
    return found


def picked(*counters: int) -> list[bytes]:
    payloads = tacho_payloads(256)
    return [payloads[counter] for counter in counters]


STUCK, JUMPED = Reason.STUCK_COUNTER, Reason.JUMPED_COUNTER


@pytest.mark.parametrize("first", [0, 1, 2, 77, 255])
def test_any_first_counter_is_accepted(first: int) -> None:
    decoder = Decoder([Tacho])

    assert outcomes(decoder, picked(first)) == [None]
    assert not decoder.lost


@pytest.mark.parametrize(
    ("counters", "expected", "lost"),
    [
        ((5, 6, 7), [None, None, None], 0),
        ((254, 255, 0, 1), [None] * 4, 0),
        ((5, 7, 8), [None] * 3, 1),
        ((5, 8, 9), [None] * 3, 2),
        ((5, 8, 11), [None] * 3, 4),
        ((254, 1), [None, None], 2),
        ((5, 9), [None, JUMPED], 0),
        ((5, 4), [None, JUMPED], 0),
        ((5, 133), [None, JUMPED], 0),
        ((5, 5), [None, STUCK], 0),
        ((5, 5, 5, 6, 7), [None, STUCK, STUCK, None, None], 0),
        ((5, 5, 7), [None, STUCK, None], 1),
        # Frames are 20 ms apart and the timeout is 60 ms, so the fourth frame after the last
        # accepted one is too late.
        ((5, 9, 10, 11, 12, 13), [None, JUMPED, JUMPED, JUMPED, None, None], 0),
        ((5, 9, 10, 11, 13, 14), [None, JUMPED, JUMPED, JUMPED, JUMPED, None], 0),
        ((5, 9, 9, 9, 9, 9, 10), [None, *[JUMPED] * 5, None], 0),
        ((5, 9, 12, 15, 18, 21), [None] + [JUMPED] * 5, 0),
        ((5, 9, 20, 31, 42), [None] + [JUMPED] * 4, 0),
        ((5, 9, 6, 10, 7, 11, 8, 12), [None, JUMPED] * 4, 0),
        ((5, 9, 10, 7, 11), [None, JUMPED, JUMPED, None, JUMPED], 1),
        ((5, 9, 10, 11, 12, 15), [None, JUMPED, JUMPED, JUMPED, None, None], 2),
        ((5, 9, 10, 11, 7, 12), [None, JUMPED, JUMPED, JUMPED, None, JUMPED], 1),
        ((5, 9, 5, 5, 5, 10, 11, 12, 13), [None, JUMPED, *[STUCK] * 3, *[JUMPED] * 3, None], 0),
        ((5, 5, 9, 10, 11, 12), [None, STUCK, JUMPED, JUMPED, JUMPED, None], 0),
        ((5, 200, 201, 202, 203, 204), [None, JUMPED, JUMPED, JUMPED, None, None], 0),
        ((9, 253, 254, 255, 0, 1), [None, JUMPED, JUMPED, JUMPED, None, None], 0),
    ],
)
def test_the_counter_decides_which_frames_are_accepted(
    counters: tuple[int, ...], expected: list[Reason | None], lost: int
) -> None:
    """Up to two frames may be missing.

    The decoder accepts a stream that jumped only when the former stream has been silent for longer
    than the timeout and the new one counts on.
    """
    decoder = Decoder([Tacho])

    assert outcomes(decoder, picked(*counters)) == expected
    assert decoder.lost[TACHO_ID] == lost


def test_every_counter_step_is_judged_alike() -> None:
    """The test checks all 65 536 pairs of counters; only one to three steps ahead are accepted.

    A silence before each pair lets the decoder accept any counter.
    """
    payloads = tacho_payloads(256)
    decoder, now_ns = Decoder([Tacho]), 0
    for before in range(256):
        for after in range(256):
            now_ns += 1000 * MS
            assert isinstance(decoder.decode(TACHO_ID, payloads[before], now_ns), Tacho)

            heard = decoder.decode(TACHO_ID, payloads[after], now_ns)

            believed = after in {(before + step) % 256 for step in (1, 2, 3)}
            assert isinstance(heard, Tacho) == believed, (before, after)


def test_after_a_silence_longer_than_the_timeout_any_counter_is_accepted() -> None:
    timeout_ns = round(binding.timeout_s(Tacho) * 1e9)
    for age_ns, expected in ((timeout_ns, Rejected), (timeout_ns + 1, Tacho)):
        for counter in (5, 200):
            decoder = Decoder([Tacho])
            decoder.decode(TACHO_ID, picked(5)[0], 1000)

            assert type(decoder.decode(TACHO_ID, picked(counter)[0], 1000 + age_ns)) is expected


def test_after_a_silence_during_a_jump_any_counter_is_accepted_too() -> None:
    decoder = Decoder([Tacho])
    for number, payload in enumerate(picked(5, 50)):
        decoder.decode(TACHO_ID, payload, number)

    heard = [decoder.decode(TACHO_ID, payload, 1000 * MS) for payload in picked(90, 92)]

    assert [type(each) for each in heard] == [Tacho, Tacho]
    assert decoder.lost[TACHO_ID] == 1


def test_a_stuck_sender_is_never_accepted_again() -> None:
    """The frames of a stuck sender keep coming, so there is no silence after which the counter
    could restart."""
    decoder = Decoder([Tacho])

    found = outcomes(decoder, picked(*[5] * 50))

    assert found == [None] + [STUCK] * 49


def test_a_sender_that_always_jumps_is_never_accepted_again() -> None:
    decoder = Decoder([Tacho])

    found = outcomes(decoder, picked(*[number * 20 % 256 for number in range(50)]))

    assert found == [None] + [JUMPED] * 49


def test_frames_replayed_beside_a_live_sender_are_all_refused() -> None:
    """Two or three of them in a row may count on between two genuine frames, but the decoder
    refuses them."""
    payloads = tacho_payloads(256)
    for behind in range(20, 250):
        times = [(number * 45, "sender") for number in range(12)]
        times += [(7 + number * 20, "repeated") for number in range(26)]
        counters = {"sender": 100, "repeated": 100 - behind}
        decoder = Decoder([Tacho])
        for now_ms, source in sorted(times):
            payload = payloads[counters[source] % 256]
            counters[source] += 1

            heard = decoder.decode(TACHO_ID, payload, now_ms * MS)

            assert isinstance(heard, Tacho) == (source == "sender"), (behind, now_ms)


@pytest.mark.parametrize(("late_ns", "expected"), [(0, Rejected), (1, Tacho)])
def test_a_new_stream_is_accepted_once_the_old_one_has_timed_out(
    late_ns: int, expected: type
) -> None:
    """The limit is exact to the nanosecond: the refused frames before do not count as the old
    stream."""
    timeout_ns = round(binding.timeout_s(Tacho) * 1e9)
    decoder = Decoder([Tacho])
    for counter, heard_ns in ((5, 0), (90, timeout_ns // 2)):
        decoder.decode(TACHO_ID, picked(counter)[0], heard_ns)

    heard = decoder.decode(TACHO_ID, picked(91)[0], timeout_ns + late_ns)

    assert type(heard) is expected


@pytest.mark.parametrize(("late_ns", "expected"), [(0, Rejected), (1, Tacho)])
def test_any_counter_is_accepted_after_a_silence_without_even_refused_frames(
    late_ns: int, expected: type
) -> None:
    timeout_ns = round(binding.timeout_s(Tacho) * 1e9)
    decoder = Decoder([Tacho])
    for counter, heard_ns in ((5, 0), (90, timeout_ns // 2)):
        decoder.decode(TACHO_ID, picked(counter)[0], heard_ns)

    heard = decoder.decode(TACHO_ID, picked(150)[0], timeout_ns // 2 + timeout_ns + late_ns)

    assert type(heard) is expected


def test_a_stream_that_took_over_stays_the_accepted_one() -> None:
    decoder = Decoder([Tacho])

    found = outcomes(decoder, picked(5, 90, 91, 92, 93, 6, 94, 7, 95))

    assert found == [None, JUMPED, JUMPED, JUMPED, None, JUMPED, None, JUMPED, None]


def test_a_corrupted_frame_does_not_affect_timeout_or_counter() -> None:
    """Only the silence counts for the timeout; noise must not keep an old counter valid."""
    decoder = Decoder([Tacho])
    decoder.decode(TACHO_ID, picked(5)[0], 0)

    for number in range(1, 70):
        heard = decoder.decode(TACHO_ID, bytes(8), number * MS)
        assert isinstance(heard, Rejected)
        assert heard.reason is Reason.WRONG_CRC

    assert isinstance(decoder.decode(TACHO_ID, picked(5)[0], 70 * MS), Tacho)


def test_a_sender_with_another_period_has_another_timeout() -> None:
    """With a period of 200 ms, the DBC's 60 ms would make every frame count as the first."""
    decoder = Decoder([Tacho], timeouts_s={Tacho: 0.6})

    assert outcomes(decoder, picked(5, 5, 6), period_ms=200) == [None, STUCK, None]
    assert outcomes(Decoder([Tacho]), picked(5, 5, 6), period_ms=200) == [None, None, None]


def test_the_encoder_counts_every_message_separately() -> None:
    encoder = Encoder([Tacho])
    doppler = Doppler(speed_mps=1.0, quality_percent=50.0, healthy=True)

    counters = [encoder.encode(frame)[0][1][-3] for frame in (TACHO, TACHO, doppler, TACHO)]

    assert counters == [0, 1, 0, 2]


def test_an_equal_payload_is_checked_as_strictly_as_a_new_one() -> None:
    """The decoder returns its cached frame, but must still check CRC and counter."""
    encoder, decoder = Encoder(), Decoder([Tacho])
    payloads = [encoder.encode(TACHO)[0][1] for _ in range(3)]
    broken = payloads[2][:-1] + bytes([payloads[2][-1] ^ 1])

    first, second = (decoder.decode(TACHO_ID, payload, 0) for payload in payloads[:2])

    assert first is second
    assert first == TACHO
    assert outcomes(decoder, [payloads[1], broken]) == [STUCK, Reason.WRONG_CRC]


def test_a_frame_with_an_invalid_value_still_advances_the_counter() -> None:
    """Direction 3 is not in the value table, but the counter of that frame is correct."""
    payloads = tacho_payloads(3)
    body = (int.from_bytes(payloads[1][:6], "little") | 3 << 26).to_bytes(6, "little")
    bad = body + crc(Tacho, body)
    decoder = Decoder([Tacho])

    assert outcomes(decoder, [payloads[0], bad, payloads[2]]) == [
        None,
        Reason.INVALID_VALUE,
        None,
    ]
    assert decoder.lost[TACHO_ID] == 0


def test_the_same_invalid_value_twice_is_refused_twice() -> None:
    payloads = tacho_payloads(2)
    bodies = [
        (int.from_bytes(payload[:6], "little") | 3 << 26).to_bytes(6, "little")
        for payload in (payloads[0], payloads[0][:5] + b"\x01")
    ]
    decoder = Decoder([Tacho])

    assert (
        outcomes(decoder, [body + crc(Tacho, body) for body in bodies])
        == [Reason.INVALID_VALUE] * 2
    )
    assert decoder.rejections == {(TACHO_ID, Reason.INVALID_VALUE): 2}


def crc(kind: type[Any], body: bytes, *, half: int = 0) -> bytes:
    """The CRC computed bit by bit as in the standard."""
    state = 0xFFFF
    data_id = binding.binding_of(kind).messages[half].attributes["SafetyDataId"]
    assert isinstance(data_id, int)
    for byte in data_id.to_bytes(2, "little") + body:
        state ^= byte << 8
        for _ in range(8):
            state = (state << 1 ^ 0x1021 if state & 0x8000 else state << 1) & 0xFFFF
    return state.to_bytes(2, "little")


def pair(command: BrakeCommand, number: int = 0) -> tuple[bytes, bytes]:
    """Both halves with the counter `number`."""
    encoder = Encoder()
    for _ in range(number + 1):
        (_, first), (_, second) = encoder.encode(command)
    return first, second


def test_a_pair_gives_its_command_with_the_second_half() -> None:
    decoder = Decoder([BrakeCommand])
    first, second = pair(RELEASED)

    assert decoder.decode(BRAKE_ID, first, 0) is None
    assert decoder.decode(BRAKE_TWIN_ID, second, MS) == RELEASED
    assert not decoder.rejections


def test_pairs_that_follow_each_other_lose_none() -> None:
    decoder = Decoder([BrakeCommand])

    for number in range(3):
        first, second = pair(RELEASED, number)
        decoder.decode(BRAKE_ID, first, 40 * number * MS)
        assert decoder.decode(BRAKE_TWIN_ID, second, (40 * number + 1) * MS) == RELEASED
    assert not decoder.lost


@pytest.mark.parametrize(
    ("gap_ns", "expected"), [(0, None), (20_000_000, None), (20_000_001, "late")]
)
def test_the_second_half_must_come_in_time(gap_ns: int, expected: str | None) -> None:
    decoder = Decoder([BrakeCommand])
    first, second = pair(RELEASED)
    decoder.decode(BRAKE_ID, first, 7 * MS)

    heard = decoder.decode(BRAKE_TWIN_ID, second, 7 * MS + gap_ns)

    if expected is None:
        assert heard == RELEASED
    else:
        assert isinstance(heard, Rejected)
        assert (heard.can_id, heard.reason) == (BRAKE_TWIN_ID, Reason.TWIN_TIMEOUT)
        assert heard.detail == "20.0 ms after BRAKE_CMD"


def test_a_twin_without_a_first_half_is_refused() -> None:
    decoder = Decoder([BrakeCommand])

    heard = decoder.decode(BRAKE_TWIN_ID, pair(RELEASED)[1], 0)

    assert isinstance(heard, Rejected)
    assert heard.reason is Reason.TWIN_MISMATCH


def test_a_first_half_without_a_twin_is_reported_with_the_next_one() -> None:
    """The next pair counts all the same."""
    decoder = Decoder([BrakeCommand])
    (lonely, _), (first, second) = pair(RELEASED, 0), pair(BRAKING, 1)
    decoder.decode(BRAKE_ID, lonely, 0)

    reported = decoder.decode(BRAKE_ID, first, 50 * MS)

    assert isinstance(reported, Rejected)
    assert (reported.can_id, reported.data) == (BRAKE_ID, lonely)
    assert reported.reason is Reason.TWIN_TIMEOUT
    assert decoder.decode(BRAKE_TWIN_ID, second, 51 * MS) == BRAKING


def test_the_twin_of_another_pair_is_refused() -> None:
    """The command is the same, so the payload fits; the counter shows another transmission."""
    decoder = Decoder([BrakeCommand])
    decoder.decode(BRAKE_ID, pair(RELEASED, 0)[0], 0)

    heard = decoder.decode(BRAKE_TWIN_ID, pair(RELEASED, 1)[1], MS)

    assert isinstance(heard, Rejected)
    assert heard.reason is Reason.TWIN_MISMATCH
    assert isinstance(decoder.decode(BRAKE_TWIN_ID, pair(RELEASED, 0)[1], 2 * MS), Rejected)


def test_a_pair_whose_halves_disagree_is_refused() -> None:
    decoder = Decoder([BrakeCommand])
    decoder.decode(BRAKE_ID, pair(RELEASED)[0], 0)

    heard = decoder.decode(BRAKE_TWIN_ID, pair(BRAKING)[1], MS)

    assert isinstance(heard, Rejected)
    assert heard.reason is Reason.TWIN_MISMATCH


def test_a_pair_counts_once() -> None:
    decoder = Decoder([BrakeCommand])
    first, second = pair(RELEASED)
    decoder.decode(BRAKE_ID, first, 0)
    assert decoder.decode(BRAKE_TWIN_ID, second, 0) == RELEASED

    heard = [decoder.decode(BRAKE_TWIN_ID, second, 0), decoder.decode(BRAKE_ID, first, 0)]

    assert [each.reason for each in heard if isinstance(each, Rejected)] == [
        Reason.TWIN_MISMATCH,
        Reason.STUCK_COUNTER,
    ]


def test_a_pair_obeys_the_counter_like_any_frame() -> None:
    decoder = Decoder([BrakeCommand])
    found: list[Any] = []
    for number in (0, 1, 9, 10, 2):
        first, second = pair(RELEASED, number)
        found.append(decoder.decode(BRAKE_ID, first, 0))
        found.append(decoder.decode(BRAKE_TWIN_ID, second, 0))

    kinds = [each.reason if isinstance(each, Rejected) else each for each in found]
    assert kinds == [
        *(None, RELEASED, None, RELEASED),
        *(Reason.JUMPED_COUNTER, Reason.TWIN_MISMATCH) * 2,
        *(None, RELEASED),
    ]


def test_a_broken_first_half_does_not_disturb_the_one_that_waits() -> None:
    decoder = Decoder([BrakeCommand])
    first, second = pair(RELEASED)
    decoder.decode(BRAKE_ID, first, 0)

    assert isinstance(decoder.decode(BRAKE_ID, bytes(len(first)), 0), Rejected)
    assert decoder.decode(BRAKE_TWIN_ID, second, 0) == RELEASED


def test_an_unknown_identifier_is_refused_and_an_unsubscribed_one_is_ignored() -> None:
    decoder = Decoder([Tacho])

    assert decoder.decode(BRAKE_ID, b"", 0) is None
    assert decoder.decode(BRAKE_TWIN_ID, b"", 0) is None
    heard = decoder.decode(0x123, b"\x01", 0)

    assert heard == Rejected(0x123, b"\x01", Reason.UNKNOWN_ID, "0x123 is in no DBC file")
    assert decoder.rejections == {(0x123, Reason.UNKNOWN_ID): 1}


def test_the_wanted_identifiers_include_those_of_twins() -> None:
    decoder = Decoder([BrakeCommand, Tacho, HEARTBEATS[Node.BCU]])

    assert decoder.ids == {BRAKE_ID, BRAKE_TWIN_ID, TACHO_ID, 0x702}


def test_a_rejection_names_the_found_and_the_expected_value() -> None:
    good = tacho_payloads(2)[1]
    bad = good[:-2] + bytes(byte ^ 0xFF for byte in good[-2:])
    found, wanted = (int.from_bytes(data[-2:], "little") for data in (bad, good))
    decoder = Decoder([Tacho])
    details = []
    for data in (b"", bad, good, good, picked(9)[0]):
        heard = decoder.decode(TACHO_ID, data, 0)
        details.append(heard.detail if isinstance(heard, Rejected) else "")

    assert details == [
        "0 bytes, TACHO has 8",
        f"CRC is {found:#06x}, should be {wanted:#06x}",
        "",
        "counter is 1 again",
        "counter is 9 after 1",
    ]


def test_an_invalid_value_is_named() -> None:
    """Direction 3 is not in the value table; -655 360 N is beyond the range of the force."""
    body = (3 << 26).to_bytes(6, "little")
    tacho = Decoder([Tacho]).decode(TACHO_ID, body + crc(Tacho, body), 0)
    body = (-32768 & 0xFFFF).to_bytes(5, "little")
    traction = Decoder([TractionStatus]).decode(0x183, body + crc(TractionStatus, body), 0)

    halves = bytes([0xB8, 0x0B, 0]), bytes([0x47, 0xF4, 0])
    decoder = Decoder([BrakeCommand])
    brake = [
        decoder.decode(BRAKE_ID + half, body + crc(BrakeCommand, body, half=half), 0)
        for half, body in enumerate(halves)
    ][1]

    assert isinstance(brake, Rejected)
    assert (brake.can_id, brake.reason) == (BRAKE_ID, Reason.INVALID_VALUE)
    assert brake.detail == "service_decel_mps2 is raw 3000, outside its range"
    assert isinstance(tacho, Rejected)
    assert tacho.detail == "direction is 3, which its value table does not have"
    assert isinstance(traction, Rejected)
    assert traction.detail == "force_n is raw -32768, outside its range"


def test_rejections_are_counted_by_identifier_and_reason() -> None:
    decoder = Decoder([Tacho, BrakeStatus])
    for data in (bytes(8), bytes(7), bytes(7)):
        decoder.decode(TACHO_ID, data, 0)
        decoder.decode(0x182, data, 0)

    assert decoder.rejections == {
        (TACHO_ID, Reason.WRONG_CRC): 1,
        (TACHO_ID, Reason.WRONG_LENGTH): 2,
        (0x182, Reason.WRONG_CRC): 2,
        (0x182, Reason.WRONG_LENGTH): 1,
    }


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (VobcMotion(math.nan, 1.0, 1.0), ("VOBC_MOTION", "speed_mps", "nan is not a number")),
        (VobcMotion(1.0, 1.0, "fast"), ("VOBC_MOTION", "emergency_mps", "'fast'", "float")),  # type: ignore[arg-type]
        (VobcMotion(None, 1.0, 1.0), ("VOBC_MOTION", "speed_mps", "None")),  # type: ignore[arg-type]
        (with_values(TACHO, pulses_a=1.5), ("TACHO", "pulses_a", "1.5", "int")),
        (with_values(TACHO, pulses_b=math.nan), ("TACHO", "pulses_b", "nan is not a number")),
        (with_values(TACHO, direction=1), ("TACHO", "direction", "Direction")),
        (with_values(TACHO, direction=Node.DESK), ("TACHO", "direction", "Direction")),
        (with_values(TACHO, healthy_a=1), ("TACHO", "healthy_a", "bool")),
        (with_values(TACHO, healthy_b=math.nan), ("TACHO", "healthy_b", "nan is not a number")),
        (LineSupply(math.nan, 0.0, True), ("LINE_SUPPLY", "line_voltage_v", "not a number")),
        (
            BrakeCommand(math.nan, True, True),
            ("BRAKE_CMD", "service_decel_mps2", "not a number"),
        ),
    ],
)
def test_a_value_that_cannot_be_encoded_is_named(frame: Any, words: tuple[str, ...]) -> None:
    encoder = Encoder()

    with pytest.raises(EncodeError) as caught:
        encoder.encode(frame)

    for word in words:
        assert word in str(caught.value)


def test_a_refused_frame_uses_up_no_counter() -> None:
    encoder = Encoder()
    encoder.encode(TACHO)
    with pytest.raises(EncodeError):
        encoder.encode(with_values(TACHO, pulses_a=math.nan))

    assert encoder.encode(TACHO)[0][1][-3] == 1


def test_a_class_without_a_message_is_the_callers_mistake() -> None:
    @dataclasses.dataclass(frozen=True, slots=True)
    class Loose:
        speed_mps: float

    with pytest.raises(TypeError, match="Loose is bound to no DBC message"):
        Encoder().encode(Loose(1.0))
    with pytest.raises(TypeError, match="Loose is bound to no DBC message"):
        Decoder([Loose])


def test_a_decoded_frame_is_frozen_like_any_other() -> None:
    heard: Any = Decoder([Tacho]).decode(TACHO_ID, tacho_payloads(1)[0], 0)

    assert heard == with_values(TACHO, pulses_a=0)
    assert hash(heard) == hash(with_values(TACHO, pulses_a=0))
    with pytest.raises(dataclasses.FrozenInstanceError):
        heard.pulses_a = 3


def test_two_bits_are_true_only_as_one_zero() -> None:
    """Every other pattern of a protected boolean gives the restrictive value."""
    found = {}
    for raw in range(4):
        body = (raw << 24 | 5 << 32).to_bytes(5, "little")
        heard = Decoder([BrakeStatus]).decode(0x182, body + crc(BrakeStatus, body), 0)
        assert isinstance(heard, BrakeStatus)
        found[raw] = heard.emergency_applied

    assert found == {0b00: False, 0b01: False, 0b10: True, 0b11: False}


@pytest.mark.parametrize("payload", [0x00, 0xFF])
def test_a_pair_of_all_zeros_and_all_ones_is_a_pair_like_any(payload: int) -> None:
    """No sender of this project sends it, but its CRCs are correct and all four values are
    false."""
    decoder = Decoder([DoorCommand])
    bodies = bytes([payload, 0]), bytes([0xFF - payload, 0])

    heard = [
        decoder.decode(0x105 + half, body + crc(DoorCommand, body, half=half), 0)
        for half, body in enumerate(bodies)
    ]

    assert heard == [None, DoorCommand(False, False, False, False)]


def test_flags_combine() -> None:
    status = VobcStatus(
        supervision=Supervision.NO_AUTHORITY,
        ato_phase=AtoPhase.OFF,
        missing=Missing.BRAKE | Missing.DESK | Missing.LOCALISATION,
        localised=False,
        slip_detected=False,
        work_us=400.0,
        cycle_slips=3,
    )

    ((can_id, data),) = Encoder().encode(status)

    assert Decoder([VobcStatus]).decode(can_id, data, 0) == status


def test_frames_of_one_shape_keep_their_node() -> None:
    """Heartbeats differ only in their sender, which their classes and identifiers show."""
    encoder, decoder = Encoder(), Decoder([*HEARTBEATS.values(), *EMERGENCIES.values()])
    for node in Node:
        alive = HEARTBEATS[node](NodeState.OPERATIONAL)
        trouble = EMERGENCIES[node](error_code=0xFF01, error_register=0x81, detail=2**40 - 1)
        for frame, can_id in ((alive, 0x700 + node), (trouble, 0x080 + node)):
            sent = encoder.encode(frame)

            assert sent[0][0] == can_id
            heard: Any = decoder.decode(*sent[0], 0)
            assert heard == frame
            assert heard.node is node
    assert HEARTBEATS[Node.BCU](NodeState.STOPPED) != HEARTBEATS[Node.TCU](NodeState.STOPPED)


def test_force_saturates_instead_of_wrapping() -> None:
    command = TractionCommand(force_n=1e9, direction=Direction.FORWARD, traction_permitted=True)
    sent = Encoder().encode(command)
    decoder = Decoder([TractionCommand])

    heard = [decoder.decode(can_id, data, 0) for can_id, data in sent][-1]

    assert heard == dataclasses.replace(command, force_n=400000.0)


def test_the_first_frame_counts_whatever_its_bits_are() -> None:
    """Before the first frame no payload counts as known, not even one with a single 1 bit."""
    least = VobcMotion(speed_mps=0.01, ceiling_mps=0.0, emergency_mps=0.0)
    ((can_id, data),) = Encoder().encode(least)

    assert int.from_bytes(data[:-3], "little") == 1
    assert Decoder([VobcMotion]).decode(can_id, data, 0) == least


def test_the_same_bits_again_are_the_same_frame_with_or_without_a_twin() -> None:
    supply = LineSupply(line_voltage_v=750.0, line_current_a=0.0, breaker_closed=True)
    for frame in (supply, RELEASED):
        encoder, decoder = Encoder(), Decoder([type(frame)])

        heard = [
            [decoder.decode(can_id, data, 0) for can_id, data in encoder.encode(frame)][-1]
            for _ in range(2)
        ]

        assert heard[0] == frame
        assert heard[0] is heard[1]


def test_a_corrupted_frame_decodes_to_minus_one() -> None:
    message = binding.binding_of(Tacho).message
    data = picked(5)[0]
    opened = opener(message)

    assert opened(data) >> 8 * (len(data) - 3) == 5
    assert opened(data[:-1]) == -1
    assert opened(data[:-1] + bytes([data[-1] ^ 1])) == -1
