"""The virtual radio delays, loses, duplicates and cuts as configured, reproducibly."""

import random
from collections import Counter

import numpy as np
import pytest

from firmware_py.ports import RadioMessage
from firmware_py.radio.inproc_radio import INBOX_MESSAGES, InprocRadio, InprocRadioPort

MS = 1_000_000
FAR_NS = 10**12


def pair(radio: InprocRadio) -> tuple[InprocRadioPort, InprocRadioPort]:
    return radio.port("wayside", ["st/**"]), radio.port("train", ["ma/7"])


def test_a_message_arrives_after_the_delay_and_not_before() -> None:
    wayside, train = pair(InprocRadio(0.020))
    wayside.send(5 * MS, "ma/7", b"go")

    assert list(train.receive(25 * MS - 1)) == []
    (message,) = train.receive(25 * MS)
    assert message == (25 * MS, "ma/7", b"go")
    assert list(train.receive(FAR_NS)) == []


def test_a_port_receives_its_subscriptions_and_not_its_own_messages() -> None:
    wayside, train = pair(InprocRadio(0.0))
    train.send(0, "st/1", b"here")
    train.send(0, "ma/7", b"own voice")
    wayside.send(0, "ma/8", b"not for us")

    assert [message.payload for message in wayside.receive(0)] == [b"here"]
    assert list(train.receive(0)) == []


def test_messages_of_one_instant_arrive_in_the_order_of_sending() -> None:
    radio = InprocRadio(0.010)
    wayside, train = pair(radio)
    other = radio.port("other", [])
    for number in range(20):
        (wayside if number % 2 else other).send(0, "ma/7", bytes([number % 7, number]))

    assert [message.payload[1] for message in train.receive(10 * MS)] == list(range(20))


def heard(seed: int, **settings: float) -> list[tuple[int, bytes]]:
    radio = InprocRadio(0.020, generator=np.random.default_rng(seed), **settings)
    wayside, train = pair(radio)
    messages: list[RadioMessage] = []
    for number in range(2000):
        wayside.send(number * 200 * MS, "ma/7", number.to_bytes(2, "big"))
        messages += train.receive((number + 1) * 200 * MS)
    return [(message.stamp_ns, message.payload) for message in messages]


def test_the_same_seed_gives_the_same_radio() -> None:
    settings = {"jitter_s": 0.05, "loss_ratio": 0.1, "duplication_ratio": 0.1}

    assert heard(1, **settings) == heard(1, **settings)
    assert heard(1, **settings) != heard(2, **settings)


def test_jitter_only_adds_and_fills_its_range() -> None:
    late_ns = [stamp_ns % (200 * MS) for stamp_ns, _ in heard(3, jitter_s=0.1)]

    assert min(late_ns) >= 20 * MS
    assert max(late_ns) < 120 * MS
    assert min(late_ns) < 22 * MS
    assert max(late_ns) > 118 * MS


def test_loss_and_duplication_have_the_configured_ratio() -> None:
    counts = Counter(payload for _, payload in heard(4, loss_ratio=0.2, duplication_ratio=0.3))

    # Six standard deviations to either side.
    assert len(counts) == pytest.approx(1600, abs=110)
    doubled = sum(count == 2 for count in counts.values())
    assert doubled == pytest.approx(0.3 * len(counts), abs=115)
    assert set(counts.values()) == {1, 2}


def test_loss_does_not_change_the_delays_of_other_messages() -> None:
    whole = {payload: stamp_ns for stamp_ns, payload in heard(5, jitter_s=0.1)}
    lossy = {payload: stamp_ns for stamp_ns, payload in heard(5, jitter_s=0.1, loss_ratio=0.5)}

    assert len(lossy) < len(whole)
    assert lossy == {payload: whole[payload] for payload in lossy}


def test_a_cut_blocks_both_directions_until_it_ends() -> None:
    radio = InprocRadio(0.001)
    wayside, train = pair(radio)
    wayside.send(0, "ma/7", b"in the air")
    radio.cut("wayside", "train")
    wayside.send(0, "ma/7", b"lost")
    train.send(0, "st/1", b"lost")

    assert [message.payload for message in train.receive(MS)] == [b"in the air"]
    assert list(wayside.receive(MS)) == []
    radio.heal()
    wayside.send(MS, "ma/7", b"again")
    assert [message.payload for message in train.receive(2 * MS)] == [b"again"]
    assert radio.cut_off == 2


def test_a_cut_of_one_direction_leaves_the_other() -> None:
    radio = InprocRadio(0.0)
    wayside, train = pair(radio)
    radio.cut("wayside", "train", both_ways=False)
    wayside.send(0, "ma/7", b"lost")
    train.send(0, "st/1", b"heard")

    assert list(train.receive(0)) == []
    assert [message.payload for message in wayside.receive(0)] == [b"heard"]


def test_every_lost_message_is_counted() -> None:
    radio = InprocRadio(0.0, loss_ratio=0.3, duplication_ratio=0.3, generator=random.Random(1))
    wayside, train = pair(radio)
    for number in range(INBOX_MESSAGES * 4):
        wayside.send(number, "ma/7", b"x")
        if number == INBOX_MESSAGES * 3:
            radio.cut("wayside", "train")
    train.receive(FAR_NS)

    arrived = train.counters.received + train.counters.dropped_in
    assert train.counters.received == INBOX_MESSAGES
    assert arrived == wayside.counters.sent - radio.lost - radio.cut_off + radio.duplicated
    assert min(radio.lost, radio.cut_off, radio.duplicated) > 0


def test_a_full_inbox_keeps_the_newest() -> None:
    wayside, train = pair(InprocRadio(0.0))
    for number in range(INBOX_MESSAGES + 5):
        wayside.send(number, "ma/7", number.to_bytes(2, "big"))

    messages = train.receive(FAR_NS)

    assert int.from_bytes(messages[0].payload, "big") == 5
    assert int.from_bytes(messages[-1].payload, "big") == INBOX_MESSAGES + 4


def test_a_closed_port_neither_sends_nor_receives() -> None:
    wayside, train = pair(InprocRadio(0.0))
    wayside.send(0, "ma/7", b"x")
    train.close()
    wayside.send(0, "ma/7", b"y")
    train.send(0, "st/1", b"z")

    assert list(train.receive(FAR_NS)) == []
    assert list(wayside.receive(FAR_NS)) == []
    assert train.counters.dropped_out == 1
