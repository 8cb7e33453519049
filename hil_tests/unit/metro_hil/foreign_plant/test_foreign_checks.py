"""Checks of what a foreign plant sends."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from can_dbc.nodes import Node
from firmware_py.grants import GrantProtocolError
from metro_hil.foreign_plant.checks import (
    LoadCheck,
    TruthCheck,
    read_frames,
    read_parts,
    received_ids,
)
from metro_hil.foreign_plant.messages import OfPlant, read_plant
from plant_emulator.foreign import LIMITS, TRUTH_OF
from plant_emulator.truth import SIGNALS

STANDING = {"front_m": 100.0, "speed_mps": 0.0, "accel_mps2": 0.0}


def test_every_reported_signal_is_a_truth_signal_with_a_range() -> None:
    reported = {name for names in TRUTH_OF.values() for name in names}

    assert reported <= set(SIGNALS)
    assert reported == set(LIMITS)


def test_every_node_of_the_train_can_be_provided() -> None:
    names = {node.name for node in Node} - {Node.VOBC.name}

    assert read_parts(sorted(TRUTH_OF)) == (True, frozenset(Node[name] for name in names))
    assert read_parts(["TCU"]) == (False, frozenset({Node.TCU}))


@pytest.mark.parametrize(
    ("parts", "words"), [([], "empty"), (["BCX"], "nearest valid"), (["VOBC"], "'VOBC'")]
)
def test_parts_that_do_not_exist_are_refused(parts: list[str], words: str) -> None:
    with pytest.raises(GrantProtocolError, match=words):
        read_parts(parts)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"front_m": None}, "truth.front_m: missing"),
        ({"speed_kmh": 0.0}, "truth.speed_kmh: no signal of its parts; nearest.*speed_mps"),
        ({"speed_mps": 151.0}, "truth.speed_mps: 151 is not within -150..150"),
        ({"accel_mps2": float("nan")}, "truth.accel_mps2: nan is not within"),
        ({"front_m": 101.0}, "truth.front_m: the train starts at 101.000 m; .* at 100.000 m"),
        ({"speed_mps": 36.0}, "truth.front_m: moves by 0.000 m.*18.000 m/s"),
    ],
)
def test_a_truth_that_cannot_be_is_refused(change: dict[str, Any], words: str) -> None:
    truth = {key: value for key, value in (STANDING | change).items() if value is not None}

    with pytest.raises(GrantProtocolError, match=words):
        TruthCheck(True, (), 100.0).checked(truth)


@given(st.lists(st.floats(-3.0, 3.0), max_size=30))
@settings(max_examples=20)
def test_a_motion_from_its_own_accelerations_is_accepted(accels_mps2: list[float]) -> None:
    check = TruthCheck(True, (), 100.0)
    front_m, speed_mps = 100.0, 0.0
    for accel_mps2 in accels_mps2:
        front_m += speed_mps * 0.01 + 0.5 * accel_mps2 * 0.01**2
        speed_mps += accel_mps2 * 0.01
        truth = {"front_m": front_m, "speed_mps": speed_mps, "accel_mps2": accel_mps2}

        assert check.checked(truth) == truth


def test_the_truth_of_a_node_is_needed_and_true_counts_as_one() -> None:
    check = TruthCheck(False, {Node.TCU}, 0.0)

    assert check.checked({"drive_n": -5.0, "traction_cut": True}) == {
        "drive_n": -5.0,
        "traction_cut": 1.0,
    }
    with pytest.raises(GrantProtocolError, match=r"truth\.traction_cut: missing"):
        check.checked({"drive_n": 0.0})


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        ((0x101, "00"), "0x101 is BRAKE_CMD of VOBC, which it does not provide"),
        ((0x183, "00"), "0x183 is TRACTION_STATUS of TCU, which it does not provide"),
        ((0x7FF, ""), "no DBC file has a message 0x7ff"),
        ((-1, ""), "no DBC file has a message"),
        ((0x182, "00" * 9), "9 bytes"),
        ((0x182, "0"), "'0' is not hexadecimal"),
    ],
)
def test_a_frame_that_the_plant_may_not_send_is_refused(frame: tuple[int, str], words: str) -> None:
    with pytest.raises(GrantProtocolError, match=words):
        read_frames([frame], {Node.BCU})


def test_frames_of_provided_nodes_keep_their_order() -> None:
    frames = [(0x702, "05"), (0x182, "0102")]

    assert read_frames(frames, {Node.BCU}) == [
        (Node.BCU, 0x702, b"\x05"),
        (Node.BCU, 0x182, b"\x01\x02"),
    ]


def test_the_plant_receives_what_no_node_of_the_train_sends() -> None:
    ids = received_ids()

    assert {0x101, 0x102, 0x7FF} <= ids
    assert not {0x182, 0x183, 0x185, 0x702} & ids


def test_frames_up_to_the_load_of_the_bus_are_accepted_and_a_flood_is_not() -> None:
    """22 frames of 8 bytes have 2442 bits, 23 have 2553, and a step carries 2500."""
    fits, floods = LoadCheck(), LoadCheck()
    for _ in range(1000):
        fits.offer([bytes(8)] * 22)

    with pytest.raises(GrantProtocolError, match="floods the bus"):
        offer(floods, 1000)


def offer(load: LoadCheck, steps: int) -> None:
    for _ in range(steps):
        load.offer([bytes(8)] * 23)


@given(st.binary(max_size=200))
@settings(max_examples=100)
def test_any_line_is_a_message_or_one_error(line: bytes) -> None:
    try:
        message = read_plant(line)
    except GrantProtocolError:
        return
    assert isinstance(message, OfPlant)
