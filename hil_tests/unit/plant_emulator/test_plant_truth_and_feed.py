"""The truth signals of the train, and how other programs receive them."""

import math
import socket
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.settings import SettingsError
from firmware_py.trackdb import load_line
from plant_emulator.cli.feed_sender import FeedSender
from plant_emulator.faults.feed import (
    FaultChange,
    TruthSample,
    pack_change,
    pack_truth,
    read_message,
)
from plant_emulator.faults.plan import read_faults
from plant_emulator.train_config import load_train
from plant_emulator.truth import PASSED_M, SIGNALS, Truth
from plant_emulator.world import World

LINE = load_line("florence")
INSTANTS_NS = st.integers(-(2**63), 2**63 - 1)
WORLD = World(load_train("florence4"), LINE, seed=1, front_m=700.0)


@given(fronts_m=st.lists(st.floats(-200.0, 6000.0), min_size=1, max_size=8))
def test_signals_that_depend_on_the_place_equal_the_map(fronts_m: list[float]) -> None:
    """The test visits places in any order and asks the map itself."""
    truth = Truth()
    for front_m in fronts_m:
        WORLD.consist.car_fronts_m[0] = front_m
        truth.read(WORLD, 0, 1234.0)
        rear_m = front_m - WORLD.train.length_m
        grade_permille = LINE.mean_gradient_permille(rear_m, front_m)
        assert truth.gradient_permille == pytest.approx(grade_permille, abs=1e-6)
        assert truth.civil_limit_mps == LINE.least_limit_mps(rear_m, front_m)
        assert (truth.front_m, truth.rear_m) == (front_m, rear_m)
        assert truth.authority_end_m == 1234.0
        stops_m = [station.stop_m for station in LINE.stations]
        ahead_m = [stop_m for stop_m in stops_m if stop_m > front_m - PASSED_M]
        assert truth.to_stop_m == (ahead_m or stops_m[-1:])[0] - front_m


def test_one_truth_may_read_several_trains() -> None:
    other = World(load_train("florence4"), LINE, seed=1, front_m=3200.0)
    truth = Truth()
    WORLD.consist.car_fronts_m[0] = 700.0
    for world in (WORLD, other, WORLD):
        truth.read(world, 0, 0.0)
        assert truth.front_m == world.front_m
        assert truth.gradient_permille == pytest.approx(world.gradient_permille)


def test_every_signal_is_an_attribute_with_a_number() -> None:
    truth = Truth()
    truth.read(WORLD, 0, 0.0)
    assert all(math.isfinite(getattr(truth, name)) for name in SIGNALS)
    assert list(SIGNALS) == sorted(SIGNALS)


@given(
    values=st.lists(st.floats(allow_nan=False), min_size=len(SIGNALS), max_size=len(SIGNALS)),
    now_ns=INSTANTS_NS,
)
def test_a_sample_arrives_as_it_was_sent(values: list[float], now_ns: int) -> None:
    truth = Truth()
    for name, value in zip(SIGNALS, values, strict=True):
        setattr(truth, name, value)

    heard = read_message(pack_truth(truth, now_ns))

    assert isinstance(heard, TruthSample)
    assert heard.now_ns == now_ns
    assert [getattr(heard.truth, name) for name in SIGNALS] == values


@given(index=st.integers(0, 2**32 - 1), active=st.booleans(), now_ns=INSTANTS_NS)
def test_a_change_arrives_as_it_was_sent(index: int, active: bool, now_ns: int) -> None:
    assert read_message(pack_change(index, active, now_ns)) == FaultChange(index, active, now_ns)


@given(st.binary(max_size=300))
def test_an_invalid_message_is_none(data: bytes) -> None:
    heard = read_message(data)
    if isinstance(heard, FaultChange):
        assert pack_change(heard.index, heard.active, heard.now_ns) == data
    elif heard is not None:
        assert len(data) == len(pack_truth(Truth(), 0))


@pytest.mark.parametrize("cut", [0, 1, 8, 9, 13, 14, 100])
def test_a_truncated_message_is_none(cut: int) -> None:
    assert read_message(pack_truth(Truth(), 5)[:cut]) is None
    assert read_message(pack_change(1, True, 5)[: min(cut, 13)]) is None


def test_the_feed_counts_undelivered_messages(tmp_path: Path) -> None:
    path = tmp_path / "feed"
    (plan,) = read_faults([{"kind": "frame_drop"}], "scenario")
    feed = FeedSender(str(path))
    feed.truth(Truth(), 1)
    assert (feed.sent, feed.lost) == (0, 1)

    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(path))
        feed.truth(Truth(), 2)
        feed.change(plan, True, 3)
        heard = [read_message(listener.recv(4096)) for _ in range(2)]
        assert isinstance(heard[0], TruthSample)
        assert heard[1] == FaultChange(0, True, 3)
        for _ in range(10_000):
            feed.change(plan, False, 4)
        assert feed.lost > 1, "a full listener is not waited for"
        assert feed.sent + feed.lost == 10_003

    lost = feed.lost
    feed.truth(Truth(), 5)
    # The feed sends the lost change again before the truth; neither arrives.
    assert feed.lost == lost + 2, "one that has gone is not waited for either"
    feed.close()


def test_a_path_that_no_socket_can_have_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"--truth-feed /tmp/x+: 205 bytes long"):
        FeedSender("/tmp/" + 200 * "x")
