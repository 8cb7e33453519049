"""The bench's end of the plant's feed, on a real socket."""

import socket
from pathlib import Path

import pytest

from firmware_py.clock.clock import WallClock
from metro_hil.realtime.feed_socket import FeedSocket, tell
from plant_emulator.cli.feed_sender import FeedSender
from plant_emulator.faults.feed import FaultChange, TruthSample, pack_change, read_message
from plant_emulator.faults.feed import pack_truth as packed
from plant_emulator.faults.plan import read_faults
from plant_emulator.truth import Truth


@pytest.fixture
def sender() -> socket.socket:
    return socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)


def test_messages_arrive_complete_and_in_order_with_their_sending_instant(
    tmp_path: Path, sender: socket.socket
) -> None:
    clock = WallClock()
    feed = FeedSocket(tmp_path / "truth", clock)
    truth = Truth()
    truth.t_s, truth.front_m = 3.25, 1234.5
    before_ns = clock.now_ns()

    assert tell(sender, tmp_path / "truth", packed(truth, 3_250_000_000))
    assert tell(sender, tmp_path / "truth", pack_change(2, True, 3_260_000_000))
    received = list(feed.receive(clock.now_ns()))
    feed.close()

    first, second = (read_message(message) for _, message in received)
    assert isinstance(first, TruthSample)
    assert (first.truth.t_s, first.truth.front_m) == (3.25, 1234.5)
    assert second == FaultChange(2, True, 3_260_000_000)
    # The kernel's stamp uses the time of day, which differs a little from the clock.
    assert all(stamp_ns >= before_ns - 1_000_000_000 for stamp_ns, _ in received)


def test_a_missing_listener_is_reported_to_the_sender_and_does_no_harm(
    tmp_path: Path, sender: socket.socket
) -> None:
    assert not tell(sender, tmp_path / "nobody", b"x")


def test_an_undelivered_change_is_sent_again_before_the_next_truth(
    tmp_path: Path,
) -> None:
    """A bus fault whose end was lost would act until the end of the run."""
    clock, path = WallClock(), tmp_path / "truth"
    sender = FeedSender(str(path))
    plans = read_faults([{"kind": "frame_drop"}], "case")
    sender.change(plans[0], True, 1)
    sender.change(plans[0], False, 2)
    feed = FeedSocket(path, clock)

    sender.truth(Truth(), 3)
    heard = [read_message(message) for _, message in feed.receive(clock.now_ns())]
    feed.close()
    sender.close()

    assert heard[:2] == [FaultChange(0, True, 1), FaultChange(0, False, 2)]
    assert isinstance(heard[2], TruthSample)
    assert len(heard) == 3
