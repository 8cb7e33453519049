"""The fuzzer: its attacks are what they claim, its judge detects violations, and it finds none."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from can_dbc.codec import Decoder
from can_dbc.rejection import Reason, Rejected
from can_dbc.vobc import Supervision
from firmware_py.tag_reader.telegram import DuplicateTelegram, TelegramParser
from metro_hil.proof.attacks import PROTECTED, Attacker, authentic
from metro_hil.proof.fuzz import FORGED, NOISE, REPLAY, episode
from metro_hil.proof.genuine import Genuine, ride
from metro_hil.proof.judge import LAG_NS, NOTHING, Shadow, broken_rules, differences, permits
from vobc.config import load_config
from vobc.vocabulary import SAFE_OUTPUT
from vobc.wire.inbox import RECEIVED_KINDS

NOISE_FRAMES = 18_000
OTHER_FRAMES = 1_000


@pytest.fixture(scope="module")
def genuine() -> Genuine:
    return ride(1)


def attacker(genuine: Genuine, seed: int = 1) -> Attacker:
    return Attacker(genuine, np.random.default_rng(seed))


def test_a_repeated_run_equals_the_run(genuine: Genuine) -> None:
    moved = [output for output in genuine.outputs if output.force_n > 0.0]

    assert len(genuine.outputs) == len(genuine.steps)
    assert len(moved) > 100
    assert any(output.enable_left or output.enable_right for output in genuine.outputs)


@pytest.mark.parametrize(
    ("kind", "frames"), [(NOISE, NOISE_FRAMES), (REPLAY, OTHER_FRAMES), (FORGED, OTHER_FRAMES)]
)
def test_twenty_thousand_frames_cause_no_permissive_output(
    genuine: Genuine, kind: str, frames: int
) -> None:
    told = episode(genuine, kind, 1, frames_max=frames)

    assert told.problem == ""
    assert told.frames > frames / 2


def test_a_decoder_refuses_noise_but_not_forged_frames(genuine: Genuine) -> None:
    decoder, drawing = Decoder(RECEIVED_KINDS), attacker(genuine)

    noise = [
        decoder.decode(f.can_id, f.data, 1)
        for f in drawing.noise(2000, 1)
        if not (f.extended or f.remote)
    ]
    forged = [
        Decoder(RECEIVED_KINDS).decode(frame.can_id, frame.data, 1)
        for seed in range(20)
        for frame in attacker(genuine, seed).forged(20, 1)
    ]

    assert all(heard is None or isinstance(heard, Rejected) for heard in noise)
    assert forged
    reasons = {heard.reason for heard in forged if isinstance(heard, Rejected)}
    assert reasons <= {Reason.INVALID_VALUE}


def test_genuine_frames_are_authentic_and_a_flipped_bit_is_not(genuine: Genuine) -> None:
    frame = next(frame for frame in genuine.frames if frame.can_id in PROTECTED)

    assert authentic(frame)
    assert not authentic(frame._replace(data=bytes((frame.data[0] ^ 1,)) + frame.data[1:]))
    assert not authentic(frame._replace(extended=True))


def test_the_judge_detects_every_violation() -> None:
    driving = replace(SAFE_OUTPUT, force_n=1.0, service_decel_mps2=0.0)
    released = replace(SAFE_OUTPUT, emergency_released=True, supervision=Supervision.NOMINAL)

    assert list(broken_rules(SAFE_OUTPUT)) == []
    assert list(broken_rules(released)) == []
    for output in (
        driving,
        replace(SAFE_OUTPUT, traction_permitted=True),
        replace(released, force_n=1.0),
        replace(released, force_n=500_000.0, service_decel_mps2=0.0),
        replace(SAFE_OUTPUT, force_n=float("nan")),
        replace(SAFE_OUTPUT, service_decel_mps2=float("nan")),
        replace(SAFE_OUTPUT, emergency_released=True),
        replace(SAFE_OUTPUT, enable_left=True),
        replace(SAFE_OUTPUT, open_right=True),
    ):
        assert list(broken_rules(output)), output
    assert list(differences(SAFE_OUTPUT, SAFE_OUTPUT)) == []
    assert list(differences(released, SAFE_OUTPUT)) == [
        "noise changed emergency_released, supervision"
    ]


@pytest.mark.parametrize("part", ["released", "traction", "left", "right"])
def test_a_recent_permission_may_be_held_for_a_limited_time(part: str) -> None:
    more, shadow = replace(NOTHING, **{part: True}), Shadow()
    assert list(shadow.more_permissive(0, more, more)) == []

    assert list(shadow.more_permissive(LAG_NS, more, NOTHING)) == []

    (words,) = shadow.more_permissive(LAG_NS + 1, more, NOTHING)
    assert words.startswith(part)
    assert list(shadow.more_permissive(LAG_NS + 2, NOTHING, NOTHING)) == []


def test_the_longest_timeout_on_the_bus_is_within_the_lag() -> None:
    config = load_config("florence4")
    timeouts_s = asdict(config.atp.timeouts).values()

    assert pytest.approx((max(timeouts_s) + 2.0 * config.cycle_ms / 1e3) * 1e9) == LAG_NS


def test_permissions_of_protection_are_recognised_whatever_operation_demands(
    genuine: Genuine,
) -> None:
    """While the train coasts or brakes, traction is permitted but not demanded."""
    both = list(zip(genuine.permits, genuine.outputs, strict=True))

    assert permits(None) == NOTHING
    assert any(each.traction and output.force_n == 0.0 for each, output in both)
    assert any(not each.traction and each.released for each, _ in both)
    assert all(each.released == output.emergency_released for each, output in both)


def test_a_telegram_without_its_closing_flag_is_a_duplicate(genuine: Genuine) -> None:
    """The telegram is one of the last eight that the parser remembers; the next telegram closes
    it."""
    parser, drawing = TelegramParser(), attacker(genuine)
    for chunk in genuine.chunks[:20]:
        parser.feed(chunk.data)
    known = {chunk.data[:-1] for chunk in genuine.chunks[12:20]}

    torn = [drawing.garbage(20, 1).data for _ in range(200)]
    whole = {data for data in torn if data in known}
    heard = [each for data in whole for each in parser.feed(data + b"\x7e")]

    assert len(whole) > 4
    assert all(isinstance(each, DuplicateTelegram) for each in heard)
