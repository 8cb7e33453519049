"""Which messages of a train the wayside accepts: those for it, once, and in order."""

import pytest

from plant_emulator.wayside.order_gate import OrderGate
from zenoh_config.messages import RefusedReason
from zenoh_config.t2t import Heartbeat, Phase, RosterAck, T2tMessage

HERE = 65_001


def heartbeat(
    boot: int, sequence: int, *, source: int = 4, destination: int = HERE, area: int = 1
) -> Heartbeat:
    return Heartbeat(source, destination, area, 7, boot, sequence, 0, Phase.ISSUING, 0, 1)


@pytest.mark.parametrize(
    ("destination", "admitted"),
    [(65_001, True), (65_535, True), (65_002, False), (65_000, False), (0, False)],
)
def test_messages_for_the_wayside_or_for_all_are_accepted(
    destination: int, *, admitted: bool
) -> None:
    gate = OrderGate(HERE)

    assert gate.admits(heartbeat(1, 1, destination=destination)) is admitted
    assert gate.refusals == ({} if admitted else {RefusedReason.WRONG_DESTINATION: 1})


@pytest.mark.parametrize(
    ("boot", "sequence", "refused"),
    [
        (5, 2, RefusedReason.NOT_NEWER),
        (5, 3, RefusedReason.NOT_NEWER),
        (5, 4, None),
        (5, 900, None),
        (6, 1, None),
        (6, 3, None),
        (9, 900, None),
        (4, 2, RefusedReason.WRONG_BOOT),
        (4, 900, RefusedReason.WRONG_BOOT),
    ],
)
def test_only_newer_messages_are_accepted(
    boot: int, sequence: int, refused: RefusedReason | None
) -> None:
    gate = OrderGate(HERE)
    gate.admits(heartbeat(5, 3))

    assert gate.admits(heartbeat(boot, sequence)) is (refused is None)
    assert gate.refusals == ({} if refused is None else {refused: 1})


def test_the_next_incarnation_replaces_one_with_high_numbers() -> None:
    gate = OrderGate(HERE)
    gate.admits(heartbeat(2, 900))

    assert gate.admits(heartbeat(3, 1))
    assert not gate.admits(heartbeat(2, 901))


def test_a_refused_message_does_not_advance_the_order() -> None:
    gate = OrderGate(HERE)
    gate.admits(heartbeat(5, 3))
    gate.admits(heartbeat(5, 900, destination=HERE + 1))
    gate.admits(heartbeat(4, 900))

    assert gate.admits(heartbeat(5, 4))


def test_refusals_are_counted_by_reason() -> None:
    gate = OrderGate(HERE)
    gate.admits(heartbeat(5, 3))
    for _ in range(3):
        gate.admits(heartbeat(5, 3))
    for _ in range(2):
        gate.admits(heartbeat(4, 9))

    assert gate.refusals == {RefusedReason.NOT_NEWER: 3, RefusedReason.WRONG_BOOT: 2}


@pytest.mark.parametrize(
    "other",
    [
        heartbeat(5, 3, source=5),
        heartbeat(5, 3, area=2),
        RosterAck(4, HERE, 1, 7, 5, 3, 0, 1),
    ],
)
def test_order_is_kept_by_sender_area_and_kind(other: T2tMessage) -> None:
    """One sender numbers all its messages with one counter, and they may arrive in another
    order."""
    gate = OrderGate(HERE)
    gate.admits(heartbeat(5, 3))

    assert gate.admits(other)
    assert not gate.admits(other)


def test_at_most_32768_streams_are_kept_and_go_on() -> None:
    gate = OrderGate(HERE)

    admitted = [gate.admits(heartbeat(1, 1, source=n)) for n in range(1, 32_770)]

    assert admitted == [True] * 32_768 + [False]
    assert gate.refusals == {RefusedReason.WRONG_SOURCE: 1}
    assert gate.admits(heartbeat(1, 2, source=1))
    assert gate.admits(heartbeat(1, 2, source=32_768))
    assert not gate.admits(heartbeat(1, 2, source=32_769))
