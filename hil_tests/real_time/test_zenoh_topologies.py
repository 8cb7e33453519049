"""Trains as clients of the wayside, as peers of each other, and mixed, over real zenoh."""

import itertools
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack

import pytest

from firmware_py.clock.clock import WallClock
from firmware_py.radio.zenoh_radio import (
    RadioError,
    SessionRole,
    ZenohRadio,
    open_peer,
    open_radio,
    pick_endpoint,
)
from metro_hil.line.network.topology import Topology, is_peer
from zenoh_config.t2t_keys import token_of, tokens, train_of_token

CLOCK = WallClock()
PATIENCE_S = 10.0
TRAINS = (1, 2, 3, 4)
BEAT_S = 0.005


class Ether:
    """Radios of a wayside and of trains, each of which subscribes to all messages."""

    def __init__(self, stack: ExitStack) -> None:
        self.endpoint = pick_endpoint()
        self.radios: dict[str, ZenohRadio] = {}
        self._stack = stack

    def open_wayside(self) -> None:
        radio = open_radio(SessionRole.WAYSIDE, self.endpoint, ["t/*"], CLOCK)
        self.radios["wayside"] = self._stack.enter_context(radio)

    def open_train(self, train: int, *, peer: bool) -> None:
        opened = (
            open_peer(self.endpoint, None, ["t/*"], CLOCK)
            if peer
            else open_radio(SessionRole.TRAIN, self.endpoint, ["t/*"], CLOCK)
        )
        self.radios[f"T{train}"] = self._stack.enter_context(opened)

    def close(self, name: str) -> None:
        self.radios.pop(name).close()

    def heard_once(self) -> list[tuple[str, str, bytes]]:
        """Each radio sends one message; return which radio received which message from which."""
        word = str(time.monotonic_ns()).encode()
        for name, radio in self.radios.items():
            radio.send(CLOCK.now_ns(), f"t/{name}", word)
        time.sleep(10 * BEAT_S)
        return [
            (name, message.key.removeprefix("t/"), message.payload)
            for name, radio in self.radios.items()
            for message in radio.receive(CLOCK.now_ns())
            if message.payload == word
        ]

    def pairs(self) -> set[tuple[str, str]]:
        return set(itertools.permutations(self.radios, 2))

    def until_heard(self, wanted: Collection[tuple[str, str]]) -> None:
        """Wait until one round delivers all wanted pairs."""
        until(lambda: {each[:2] for each in self.heard_once()} >= set(wanted))


def until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s, "it did not come to pass"
        time.sleep(BEAT_S)


@pytest.fixture
def ether() -> Iterator[Ether]:
    with ExitStack() as stack:
        yield Ether(stack)


@pytest.mark.parametrize("topology", Topology)
@pytest.mark.parametrize("wayside_first", [True, False])
def test_every_radio_receives_every_message_exactly_once(
    ether: Ether, topology: Topology, wayside_first: bool
) -> None:
    if wayside_first:
        ether.open_wayside()
    for train in TRAINS:
        ether.open_train(train, peer=is_peer(topology, train))
    if not wayside_first:
        ether.open_wayside()

    ether.until_heard(ether.pairs())

    heard = [each[:2] for _ in range(20) for each in ether.heard_once()]
    assert len(heard) <= 20 * len(ether.pairs())
    assert all(radio.connected for radio in ether.radios.values())


def test_peers_go_on_without_the_wayside_and_find_it_again(ether: Ether) -> None:
    ether.open_wayside()
    for train in TRAINS:
        ether.open_train(train, peer=is_peer(Topology.MIXED, train))
    ether.until_heard(ether.pairs())

    ether.close("wayside")

    until(lambda: {each[:2] for each in ether.heard_once()} == {("T1", "T3"), ("T3", "T1")})
    ether.open_wayside()
    ether.until_heard(ether.pairs())


def test_a_peer_without_others_starts_and_ends_at_once(ether: Ether) -> None:
    began_s = time.monotonic()
    ether.open_train(1, peer=True)
    assert not ether.radios["T1"].connected
    ether.close("T1")

    assert time.monotonic() - began_s < PATIENCE_S / 2


def test_a_display_knows_the_present_sessions(ether: Ether) -> None:
    """This includes sessions that came before the display, and holds again after the wayside was
    gone."""
    ether.open_wayside()
    with ExitStack() as stack:

        def opened(train: int, *, peer: bool = False) -> ZenohRadio:
            token = token_of("loop", train)
            return stack.enter_context(
                open_peer(ether.endpoint, None, [], CLOCK, token=token)
                if peer
                else open_radio(SessionRole.TRAIN, ether.endpoint, [], CLOCK, token=token)
            )

        first = opened(1)
        until(lambda: first.connected)
        display = stack.enter_context(
            open_radio(SessionRole.TRAIN, ether.endpoint, [], CLOCK, watched_tokens=tokens("loop"))
        )

        def present() -> set[int | None]:
            return {train_of_token(each) for each in display.present}

        until(lambda: present() == {1})
        opened(2, peer=True)
        stack.enter_context(
            open_radio(SessionRole.TRAIN, ether.endpoint, [], CLOCK, token=token_of("other", 3))
        )
        until(lambda: present() == {1, 2})
        first.close()
        until(lambda: present() == {2})

        ether.close("wayside")
        until(lambda: present() == set())
        ether.open_wayside()
        until(lambda: present() == {2})


@pytest.mark.parametrize("key", ["m/loop/w/1/tr", "m/loop/w/x/up", "m/loop/w/1/up/2", "up", ""])
def test_an_invalid_token_belongs_to_no_train(key: str) -> None:
    assert train_of_token(key) is None
    assert train_of_token(token_of("loop", 7)) == 7


@pytest.mark.parametrize(
    ("endpoint", "listens_at", "complaint"),
    [
        ("here", None, "here: not an endpoint"),
        ("tcp/127.0.0.1:7448", "there", "there: not an endpoint"),
        ("tcp/nowhere.invalid:7448", None, "tcp/nowhere.invalid:7448: the address of this machine"),
        (
            "tcp/127.0.0.1:7448",
            "tcp/192.0.2.1:0",
            "tcp/192.0.2.1:0: not an address of this machine",
        ),
    ],
)
def test_an_impossible_peer_is_refused_with_the_reason(
    endpoint: str, listens_at: str | None, complaint: str
) -> None:
    with pytest.raises(RadioError) as caught:
        open_peer(endpoint, listens_at, [], CLOCK)

    assert str(caught.value).startswith(complaint)
