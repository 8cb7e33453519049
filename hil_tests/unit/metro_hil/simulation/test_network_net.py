"""The simulated network treats nodes and messages as configured, reproducibly for a seed."""

import itertools
import zlib
from collections import Counter as Tally
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from metro_hil.simulation.clocks import NodeClock
from metro_hil.simulation.event_queue import SimulatedNetwork
from metro_hil.simulation.links import Weather
from metro_hil.simulation.node import NEVER, Doom, NodeStep, QueuedMessage, SimulatedNode

MS = 1_000_000
S = 1_000_000_000


@dataclass
class Listener:
    """Records received messages with the instants by its own clock."""

    heard: list[tuple[int, tuple[Any, ...]]] = field(default_factory=list)

    def step(self, now_ns: int, heard: Sequence[Any]) -> NodeStep:
        if heard:
            self.heard.append((now_ns, tuple(heard)))
        return NodeStep((), None, NEVER)

    @property
    def messages(self) -> list[Any]:
        return [message for _, messages in self.heard for message in messages]


@dataclass
class Counter:
    """Sends the next number to all targets every `period_ns`, and stores it on its disk."""

    targets: tuple[int, ...]
    period_ns: int
    number: int = 0
    due_ns: int = 0

    def step(self, now_ns: int, heard: Sequence[Any]) -> NodeStep:
        if now_ns < self.due_ns:
            return NodeStep((), self.number, self.due_ns)
        self.number += 1
        self.due_ns = now_ns + self.period_ns
        each = [QueuedMessage((target,), self.number) for target in self.targets]
        return NodeStep(each, self.number, self.due_ns)


def network(
    seed: int = 1, *, period_ns: int = 100 * MS, listeners: int = 1, **more: Any
) -> SimulatedNetwork:
    """Node 1 counts; nodes 2 and up listen."""
    net = SimulatedNetwork(seed, **more)
    targets = tuple(range(2, 2 + listeners))

    def start(node: SimulatedNode, now_ns: int) -> Counter:
        return Counter(targets, period_ns, node.disk or 0)

    net.add(SimulatedNode(1, "counter", start, NodeClock(0, 0)))
    for target in targets:
        net.add(
            SimulatedNode(
                target, f"listener {target}", lambda node, now_ns: Listener(), NodeClock(0, 0)
            )
        )
    for address in net.nodes:
        net.boot(address)
    return net


def listener(net: SimulatedNetwork, address: int = 2) -> Listener:
    machine = net.nodes[address].machine
    assert isinstance(machine, Listener)
    return machine


def run_hash(seed: int) -> str:
    net = network(seed, listeners=3)
    net.weather(net.links(), Weather(spread_ns=40 * MS, loss_share=0.1, double_share=0.1))
    net.run(20 * S)
    return net.trace.digest()


def test_the_same_seed_is_the_same_run_and_another_is_another() -> None:
    assert run_hash(7) == run_hash(7)
    assert run_hash(7) != run_hash(8)


def test_messages_come_in_order_and_once_on_a_clear_link() -> None:
    net = network()

    net.run(10 * S)

    assert listener(net).messages == list(range(1, len(listener(net).messages) + 1))
    assert len(listener(net).messages) in (100, 101)


def test_a_stopped_node_sends_nothing_and_then_processes_all_waiting_messages_at_once() -> None:
    net = network(listeners=2)
    net.run(1 * S)
    before = len(listener(net, 2).heard)

    net.stop(2, 2 * S)
    net.run(3 * S - 1)
    assert len(listener(net, 2).heard) == before
    net.run(3 * S + 1 * MS)
    assert len(listener(net, 2).heard[-1][1]) in (19, 20, 21)

    sent = net.sent
    net.stop(1, 2 * S)
    net.run(4 * S)
    assert net.sent == sent


def test_a_node_stopped_before_sending_sends_an_early_decision_late() -> None:
    net = network()
    net.run(1 * S - 20 * MS)
    net.nodes[1].freeze_ns = 3 * S

    net.run(6 * S)

    messages, gaps_ns = listener(net).messages, [at for at, _ in listener(net).heard]
    assert messages == sorted(messages)
    assert max(b - a for a, b in itertools.pairwise(gaps_ns)) > 2.9 * S
    late = next(at for at, said in listener(net).heard if 11 in said)
    assert 3.9 * S < late < 4.1 * S


@pytest.mark.parametrize(
    ("doom", "disk", "came"),
    [
        (Doom.BEFORE_STORING, 10, 0),
        (Doom.BEFORE_SENDING, 11, 0),
        (Doom.WHILE_SENDING, 11, 2),
    ],
)
def test_the_point_of_the_kill_in_a_step_decides_what_is_stored_and_sent(
    doom: Doom, disk: int, came: int
) -> None:
    net = network(listeners=3)
    net.run(950 * MS)
    assert net.nodes[1].disk == 10

    net.nodes[1].doom = doom
    net.run(2 * S)

    assert net.nodes[1].machine is None
    assert net.nodes[1].disk == disk
    assert sum(11 in listener(net, target).messages for target in (2, 3, 4)) == came


def test_a_restarted_node_has_its_stored_data_unless_its_disk_is_lost() -> None:
    net = network()
    net.run(1 * S)
    kept = net.nodes[1].disk
    net.kill(1)
    net.boot(1)
    machine = net.nodes[1].machine
    assert isinstance(machine, Counter)
    assert machine.number == kept > 0

    net.kill(1, disk_lost=True)
    net.boot(1)
    machine = net.nodes[1].machine
    assert isinstance(machine, Counter)
    assert machine.number == 0
    assert net.nodes[1].boots == 3


def test_unsent_messages_of_a_dead_node_are_never_sent() -> None:
    net = network()
    net.nodes[1].slow_ns = 60 * MS
    net.run(1 * S + 30 * MS)
    before = max(listener(net).messages)

    net.kill(1)
    net.boot(1)
    net.run(1 * S + 140 * MS)

    assert before + 1 not in listener(net).messages


def test_a_cut_is_one_way_and_overlapping_cuts_heal_with_the_last() -> None:
    net = network(listeners=2)
    net.cut([(1, 2)])
    net.cut([(1, 2), (2, 1)])
    net.run(1 * S)
    assert listener(net, 2).messages == []
    assert len(listener(net, 3).messages) > 5

    net.heal([(1, 2)])
    net.run(2 * S)
    assert listener(net, 2).messages == []
    net.heal([(1, 2), (2, 1)])
    net.run(3 * S)
    assert listener(net, 2).messages == list(range(22, 31))


def test_a_cut_that_holds_messages_delivers_them_in_one_old_burst() -> None:
    net = network()
    net.cut([(1, 2)], keeps=True)
    net.run(2 * S)
    net.heal([(1, 2)])
    net.run(2 * S + 10 * MS)

    assert listener(net).messages[:20] == list(range(1, 21))


def test_links_lose_double_delay_and_reorder_at_the_configured_rates() -> None:
    net = network(period_ns=5 * MS)
    net.weather(net.links(), Weather(spread_ns=30 * MS, loss_share=0.2, double_share=0.1))
    net.run(60 * S)

    tally = Tally(listener(net).messages)
    sent = net.sent
    assert 0.17 < 1.0 - len(tally) / sent < 0.23
    assert 0.07 < sum(n == 2 for n in tally.values()) / len(tally) < 0.13
    assert listener(net).messages != sorted(listener(net).messages)


def test_late_messages_arrive_much_later() -> None:
    net = network()
    net.weather(net.links(), Weather(late_share=0.2, late_ns=3 * S))
    net.run(30 * S)
    net.kill(1)
    net.run(40 * S)

    assert sorted(listener(net).messages) == list(range(1, net.sent + 1))
    worst = max(at - (number - 1) * 100 * MS for at, said in listener(net).heard for number in said)
    assert worst > 1 * S


class Sealed:
    """Numbers as bytes with a checksum."""

    refused = 0

    def seal(self, message: Any) -> bytes:
        body: bytes = message.to_bytes(4, "big")
        return body + zlib.crc32(body).to_bytes(4, "big")

    def open(self, payload: bytes) -> Any:
        if zlib.crc32(payload[:4]).to_bytes(4, "big") != payload[4:]:
            self.refused += 1
            return None
        return int.from_bytes(payload[:4], "big")


def test_damaged_bytes_reach_the_codec_and_not_the_node() -> None:
    codec = Sealed()
    net = network(codec=codec)
    net.weather(net.links(), Weather(damage_share=0.3))
    net.run(60 * S)

    assert net.damaged > 100
    assert codec.refused > 0.9 * net.damaged
    messages = listener(net).messages
    assert len(messages) == len(set(messages))
    assert set(messages) <= set(range(1, net.sent + 1))


def test_values_that_cannot_be_damaged_as_bytes_are_lost() -> None:
    net = network()
    net.weather(net.links(), Weather(damage_share=0.3))
    net.run(60 * S)
    net.kill(1)
    net.run(61 * S)

    assert len(listener(net).messages) == net.sent - net.damaged


@given(
    drift_ppm=st.integers(-100_000, 100_000),
    local_ns=st.integers(0, 10**15),
    later_ns=st.integers(0, 10**13),
)
def test_a_clock_read_at_the_instant_computed_for_a_reading_has_just_reached_it(
    drift_ppm: int, local_ns: int, later_ns: int
) -> None:
    clock = NodeClock(5, local_ns, drift_ppm)
    wanted = local_ns + later_ns

    at_ns = clock.true_ns(wanted)

    assert clock.local_ns(at_ns) >= wanted
    assert at_ns == 5 or clock.local_ns(at_ns - 1) < wanted


def test_changing_the_drift_of_a_clock_does_not_make_it_jump_and_a_step_does() -> None:
    clock = NodeClock(0, 1000, 50)
    before = clock.local_ns(10**9)
    clock.drift(10**9, -200)
    assert clock.local_ns(10**9) == before
    assert clock.local_ns(2 * 10**9) == before + 10**9 - 200_000
    clock.step(10**9, 77)
    assert clock.local_ns(10**9) == before + 77


def test_a_clock_that_steps_forwards_wakes_its_node_early() -> None:
    net = SimulatedNetwork(1)
    net = network(period_ns=10 * S)
    net.run(1 * S)
    assert net.nodes[1].disk == 1

    net.step_clock(1, 20 * S)
    net.run(1 * S + 1 * MS)

    assert net.nodes[1].disk == 2


def test_a_bounded_inbox_drops_the_oldest() -> None:
    net = network(period_ns=1 * MS)
    net.stop(2, 2 * S)
    net.run(2 * S + 1 * MS)

    piled = listener(net).heard[0][1]
    assert len(piled) == 256
    assert piled[-1] > 1900
