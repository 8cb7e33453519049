"""Faults of the tag reader's line and of the radio, between two ports in virtual time."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.ports import LinkCounters, RadioMessage, SerialChunk
from firmware_py.tag_reader.telegram import (
    DuplicateTelegram,
    HealthTelegram,
    TelegramParser,
    TornTelegram,
    encode,
)
from plant_emulator.faults.plan import FaultPlan, read_faults
from plant_emulator.faults.radio_faults import RadioFaults
from plant_emulator.faults.serial_faults import SerialFaults

MS = 1_000_000
S = 1000 * MS
SEED = 11


class Wire:
    """A serial port that records sent data and returns prepared data."""

    def __init__(self) -> None:
        self.counters = LinkCounters()
        self.sent: list[tuple[int, bytes]] = []
        self.coming: list[SerialChunk] = []

    def send(self, now_ns: int, data: bytes) -> None:
        self.sent.append((now_ns, data))

    def receive(self, now_ns: int) -> list[SerialChunk]:
        coming, self.coming = self.coming, []
        return coming

    def close(self) -> None:
        pass

    @property
    def line(self) -> bytes:
        return b"".join(data for _, data in self.sent)


class Air:
    """The same for a radio."""

    def __init__(self) -> None:
        self.counters = LinkCounters()
        self.sent: list[tuple[int, bytes]] = []
        self.coming: list[RadioMessage] = []

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        assert key == "key"
        self.sent.append((now_ns, payload))

    def receive(self, now_ns: int) -> list[RadioMessage]:
        coming = [message for message in self.coming if message.stamp_ns <= now_ns]
        self.coming = self.coming[len(coming) :]
        return coming

    def close(self) -> None:
        pass


def plan(kind: str, **parameters: Any) -> FaultPlan:
    return read_faults([{"kind": kind, **parameters}], "test")[0]


def telegram(number: int) -> bytes:
    return encode(HealthTelegram(number % 256, 500.0 * number, True, 0, 0, number))


def run_serial(
    *plans: FaultPlan, telegrams: int = 40, seed: int = SEED
) -> tuple[Wire, SerialFaults]:
    """Send a telegram every 100 ms and poll every 10 ms; all faults act for the first 2 s."""
    wire = Wire()
    faults = SerialFaults(wire, seed)
    for each in plans:
        faults.change(each, True, 0)
    for step in range(telegrams * 10 + 100):
        now_ns = step * 10 * MS
        if now_ns == 2 * S:
            for each in plans:
                faults.change(each, False, now_ns)
        faults.poll(now_ns)
        if step % 10 == 0 and step < telegrams * 10:
            faults.send(now_ns, telegram(step // 10))
    return wire, faults


def test_without_a_fault_every_telegram_passes_at_once() -> None:
    wire, faults = run_serial()

    assert wire.sent == [(n * 100 * MS, telegram(n)) for n in range(40)]
    assert not faults.done


@pytest.mark.parametrize("kind", ["telegram_torn", "telegram_corrupt"])
def test_no_damaged_telegram_is_accepted(kind: str) -> None:
    wire, faults = run_serial(plan(kind))

    heard = TelegramParser().feed(wire.line)

    assert faults.done[kind] == 20
    sound = [each for each in heard if isinstance(each, HealthTelegram)]
    assert [each.uptime_s for each in sound if each.uptime_s >= 21] == list(range(21, 40))
    # A telegram without its closing flag is still complete: the next opening flag ends it.
    whole = [n for n in range(20) if wire.sent[n][1] == telegram(n)[:-1]]
    assert [each.uptime_s for each in sound if each.uptime_s < 20] == whole
    assert any(isinstance(each, TornTelegram) for each in heard)


def test_a_share_of_the_telegrams_is_damaged_and_the_rest_is_intact() -> None:
    wire, faults = run_serial(plan("telegram_corrupt", share_ratio=0.5, bits=3))

    whole = sum(data == telegram(n) for n, (_, data) in enumerate(wire.sent))

    assert 3 <= faults.done["telegram_corrupt"] <= 17
    assert whole == 40 - faults.done["telegram_corrupt"]


def test_delayed_telegrams_stay_in_order_when_the_delay_ends() -> None:
    wire, faults = run_serial(plan("telegram_delay", delay_s=0.35))

    assert [data for _, data in wire.sent] == [telegram(n) for n in range(40)]
    assert [at_ns for at_ns, _ in wire.sent[:20]] == [n * 100 * MS + 350 * MS for n in range(20)]
    # The last delayed telegram leaves at 2.25 s; those sent from 2.0 to 2.2 s wait for it.
    assert [at_ns for at_ns, _ in wire.sent[20:24]] == [2250 * MS, 2250 * MS, 2250 * MS, 2300 * MS]
    assert faults.held == 0


def test_a_repeated_telegram_is_received_as_a_duplicate() -> None:
    wire, _ = run_serial(plan("telegram_duplicate", gap_s=0.5))

    heard = TelegramParser().feed(wire.line)

    assert sum(isinstance(each, HealthTelegram) for each in heard) == 40
    assert sum(isinstance(each, DuplicateTelegram) for each in heard) == 20


def test_nothing_passes_a_cut_line_in_either_direction() -> None:
    wire = Wire()
    faults = SerialFaults(wire, SEED)
    cut = plan("serial_cut")
    faults.change(cut, True, 0)
    faults.send(0, b"lost")
    wire.coming = [SerialChunk(0, b"unheard")]
    unheard = faults.receive(0)
    faults.change(cut, False, S)
    faults.send(S, b"there")
    wire.coming = [SerialChunk(S, b"heard")]

    assert wire.sent == [(S, b"there")]
    assert list(unheard) == []
    assert list(faults.receive(S)) == [SerialChunk(S, b"heard")]
    assert faults.done == {"serial_cut": 2}


def test_noise_comes_at_its_rate_and_damages_only_the_telegrams_it_hits() -> None:
    wire, faults = run_serial(plan("serial_noise", bytes_per_s=500.0))

    heard = TelegramParser().feed(wire.line)

    # 1000 bytes are expected in 2 s; five standard deviations of a Poisson count are 158.
    assert 842 <= faults.done["serial_noise"] <= 1158
    assert len(wire.line) == sum(len(telegram(n)) for n in range(40)) + faults.done["serial_noise"]
    sound = {each.uptime_s for each in heard if isinstance(each, HealthTelegram)}
    assert set(range(21, 40)) <= sound
    assert any(data != telegram(0) and len(data) > 20 for _, data in wire.sent)


def test_the_same_seed_gives_the_same_line_and_another_one_does_not() -> None:
    def line(seed: int) -> list[tuple[int, bytes]]:
        plans = [plan("telegram_corrupt", share_ratio=0.5), plan("serial_noise")]
        return run_serial(
            *(FaultPlan(n, p.kind, p.parameters, p.window) for n, p in enumerate(plans)), seed=seed
        )[0].sent

    assert line(1) == line(1)
    assert line(1) != line(2)


def run_radio(*plans: FaultPlan, messages: int = 30) -> tuple[Air, list[RadioMessage], RadioFaults]:
    """Send a message each way every 500 ms and poll every 10 ms; all faults act for the first 10
    s."""
    air = Air()
    faults = RadioFaults(air, SEED)
    heard: list[RadioMessage] = []
    for each in plans:
        faults.change(each, True, 0)
    for step in range(messages * 50 + 500):
        now_ns = step * 10 * MS
        if now_ns == 10 * S:
            for each in plans:
                faults.change(each, False, now_ns)
        faults.poll(now_ns)
        if step % 50 == 0 and step < messages * 50:
            name = b"%d" % (step // 50)
            faults.send(now_ns, "key", name)
            air.coming.append(RadioMessage(now_ns, "key", name))
        heard += faults.receive(now_ns)
    assert faults.held == 0
    return air, heard, faults


NAMES = [b"%d" % n for n in range(30)]


def test_lost_messages_are_counted_and_never_come() -> None:
    air, heard, faults = run_radio(plan("radio_loss", loss_ratio=0.5))

    arrived = len(air.sent) + len(heard)
    assert faults.done["radio_loss"] + arrived == 60
    assert 5 <= faults.done["radio_loss"] <= 35


def test_a_delayed_message_carries_the_instant_at_which_it_arrives() -> None:
    air, heard, _ = run_radio(plan("radio_delay", delay_s=0.4))

    assert [at_ns for at_ns, _ in air.sent[:20]] == [n * 500 * MS + 400 * MS for n in range(20)]
    assert [each.stamp_ns for each in heard[:20]] == [n * 500 * MS + 400 * MS for n in range(20)]
    assert [each.stamp_ns for each in heard[20:]] == [n * 500 * MS for n in range(20, 30)]


@pytest.mark.parametrize(
    "fault", [plan("radio_reorder"), plan("radio_delay", delay_s=0.1, jitter_s=2.0)]
)
def test_reordering_and_jitter_lose_nothing(fault: FaultPlan) -> None:
    air, heard, _ = run_radio(fault)

    for names in ([data for _, data in air.sent], [each.payload for each in heard]):
        assert names != NAMES
        assert sorted(names) == sorted(NAMES)


def test_a_duplicate_comes_after_its_gap() -> None:
    air, heard, faults = run_radio(plan("radio_duplicate", gap_s=0.7))

    assert faults.done["radio_duplicate"] == 40
    for n in range(20):
        wanted = [n * 500 * MS, n * 500 * MS + 700 * MS]
        assert [at_ns for at_ns, data in air.sent if data == NAMES[n]] == wanted
        assert [each.stamp_ns for each in heard if each.payload == NAMES[n]] == wanted


def test_nothing_crosses_a_partition_and_everything_does_after_it() -> None:
    air, heard, faults = run_radio(plan("radio_partition"))

    assert [data for _, data in air.sent] == NAMES[20:]
    assert [each.payload for each in heard] == NAMES[20:]
    assert faults.done["radio_partition"] == 40


@given(delay_s=st.floats(0.0, 3.0), loss_ratio=st.floats(0.0, 1.0), seed=st.integers(0, 100))
def test_every_message_arrives_or_is_counted(delay_s: float, loss_ratio: float, seed: int) -> None:
    air = Air()
    faults = RadioFaults(air, seed)
    tables = [
        {"kind": "radio_delay", "delay_s": delay_s, "jitter_s": 1.0},
        {"kind": "radio_loss", "loss_ratio": loss_ratio},
        {"kind": "radio_duplicate", "share_ratio": 0.5},
    ]
    for each in read_faults(tables, "test"):
        faults.change(each, True, 0)

    for n in range(20):
        faults.send(n * 100 * MS, "key", b"%d" % n)
    faults.poll(60 * S)

    assert len(air.sent) == 20 - faults.done["radio_loss"] + faults.done["radio_duplicate"]
