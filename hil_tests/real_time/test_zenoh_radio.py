"""The radio over real zenoh on loopback: it connects, reconnects, stays bounded, always ends."""

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from firmware_py.clock.clock import WallClock
from firmware_py.ports import RadioMessage, RadioPort
from firmware_py.radio.zenoh_radio import (
    INBOX_MESSAGES,
    PUBLISHERS,
    RadioError,
    SessionRole,
    ZenohRadio,
    open_radio,
    pick_endpoint,
)
from zenoh_config import keys
from zenoh_config.codec import pack, unpack
from zenoh_config.messages import MovementAuthority, PositionReport

LINE = "florence"
CLOCK = WallClock()
PATIENCE_S = 5.0
REPORT = PositionReport(7, 1, 1, 10, 100.0, 101.0, 31.0, 5.0, False)
AUTHORITY = MovementAuthority(7, 1, 1, 1, 10, 900.0)

Opener = Callable[..., ZenohRadio]


@pytest.fixture
def radio() -> Iterator[Opener]:
    """Opens radios of either role; they are closed at the end of the test."""
    with ExitStack() as stack:

        def opened(role: SessionRole, endpoint: str, train: int = 7) -> ZenohRadio:
            wanted = (
                keys.reports(LINE) if role is SessionRole.WAYSIDE else keys.authorities(LINE, train)
            )
            return stack.enter_context(open_radio(role, endpoint, [wanted], CLOCK))

        yield opened


def until(condition: Callable[[], object]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s, "it did not come to pass"
        time.sleep(0.002)


def passes_on(sender: RadioPort, receiver: RadioPort, key: str, payload: bytes) -> RadioMessage:
    """Send like a control cycle until a message arrives, because the first ones may be lost."""
    heard: list[RadioMessage] = []

    def tried() -> bool:
        sender.send(CLOCK.now_ns(), key, payload)
        heard.extend(receiver.receive(CLOCK.now_ns()))
        return bool(heard)

    until(tried)
    return heard[0]


def close_settled(wayside: ZenohRadio) -> None:
    """Zenoh 1.10 keeps a connection that it is still setting up when its session is closed."""
    time.sleep(0.1)
    wayside.close()


def all_until(receiver: RadioPort, last: bytes, now_ns: int) -> list[RadioMessage]:
    heard: list[RadioMessage] = []

    def came() -> bool:
        heard.extend(receiver.receive(now_ns))
        return bool(heard) and heard[-1].payload == last

    until(came)
    return heard


def test_a_report_is_sent_and_an_authority_comes_back(radio: Opener) -> None:
    endpoint = pick_endpoint()
    wayside, train = radio(SessionRole.WAYSIDE, endpoint), radio(SessionRole.TRAIN, endpoint)
    started_ns = CLOCK.now_ns()

    report = passes_on(train, wayside, keys.report(LINE, 7), pack(REPORT))
    authority = passes_on(wayside, train, keys.authority(LINE, 0, 7), pack(AUTHORITY))

    assert report.key == keys.report(LINE, 7)
    assert unpack(report.payload) == REPORT
    assert unpack(authority.payload) == AUTHORITY
    assert started_ns < report.stamp_ns <= authority.stamp_ns <= CLOCK.now_ns()
    assert wayside.connected
    assert train.connected


def test_a_train_receives_only_messages_for_it(radio: Opener) -> None:
    endpoint = pick_endpoint()
    wayside = radio(SessionRole.WAYSIDE, endpoint)
    first, second = radio(SessionRole.TRAIN, endpoint, 1), radio(SessionRole.TRAIN, endpoint, 2)
    passes_on(wayside, first, keys.authority(LINE, 0, 1), b"for 1")

    assert passes_on(wayside, second, keys.authority(LINE, 0, 2), b"for 2").payload == b"for 2"
    assert {message.payload for message in first.receive(CLOCK.now_ns())} <= {b"for 1"}


def test_no_radio_receives_its_own_messages(radio: Opener) -> None:
    endpoint = pick_endpoint()
    wayside, train = radio(SessionRole.WAYSIDE, endpoint), radio(SessionRole.TRAIN, endpoint)
    wayside.send(CLOCK.now_ns(), keys.report(LINE, 7), b"own voice")

    heard = passes_on(train, wayside, keys.report(LINE, 7), b"train")

    assert heard.payload == b"train"


def test_a_message_is_never_stamped_later_than_the_cycle_that_receives_it(radio: Opener) -> None:
    endpoint = pick_endpoint()
    wayside, train = radio(SessionRole.WAYSIDE, endpoint), radio(SessionRole.TRAIN, endpoint)
    passes_on(train, wayside, keys.report(LINE, 7), b"x")
    cycle_ns = CLOCK.now_ns()
    train.send(cycle_ns, keys.report(LINE, 7), b"after the cycle began")

    heard = all_until(wayside, b"after the cycle began", cycle_ns)

    assert heard[-1].stamp_ns == cycle_ns


def test_a_train_without_a_wayside_goes_on_and_finds_it_later(radio: Opener) -> None:
    """Opening would hang forever here if it waited for the wayside."""
    endpoint = pick_endpoint()
    train = radio(SessionRole.TRAIN, endpoint)
    for _ in range(10):
        train.send(CLOCK.now_ns(), keys.report(LINE, 7), b"anybody?")

    assert list(train.receive(CLOCK.now_ns())) == []
    assert not train.connected
    assert (train.counters.sent, train.counters.dropped_out) == (0, 10)

    wayside = radio(SessionRole.WAYSIDE, endpoint)
    passes_on(train, wayside, keys.report(LINE, 7), pack(REPORT))
    passes_on(wayside, train, keys.authority(LINE, 0, 7), pack(AUTHORITY))


def test_a_train_finds_a_wayside_that_was_restarted(radio: Opener) -> None:
    endpoint = pick_endpoint()
    train, wayside = radio(SessionRole.TRAIN, endpoint), radio(SessionRole.WAYSIDE, endpoint)
    passes_on(train, wayside, keys.report(LINE, 7), b"before")
    close_settled(wayside)
    until(lambda: not train.connected)
    train.send(CLOCK.now_ns(), keys.report(LINE, 7), b"into nothing")

    wayside = radio(SessionRole.WAYSIDE, endpoint)

    assert passes_on(train, wayside, keys.report(LINE, 7), b"after").payload == b"after"
    assert passes_on(wayside, train, keys.authority(LINE, 0, 7), b"again").payload == b"again"


def test_a_train_with_new_subscriptions_receives_only_those(radio: Opener) -> None:
    endpoint = pick_endpoint()
    wayside, train = radio(SessionRole.WAYSIDE, endpoint), radio(SessionRole.TRAIN, endpoint)
    passes_on(wayside, train, keys.authority(LINE, 0, 7), b"before")

    train.listen([keys.authorities(LINE, 8), keys.authorities(LINE, 9)])
    passes_on(wayside, train, keys.authority(LINE, 0, 8), b"one")
    train.listen([keys.authorities(LINE, 9)])
    passes_on(wayside, train, keys.authority(LINE, 0, 9), b"other")

    for other, said in ((7, b"7"), (8, b"8"), (9, b"last")):
        wayside.send(CLOCK.now_ns(), keys.authority(LINE, 0, other), said)
    heard = all_until(train, b"last", CLOCK.now_ns())
    assert {each.payload for each in heard} <= {b"one", b"other", b"last"}
    assert train.counters.errors == 0


def test_subscriptions_outlive_the_wayside_and_do_not_wait_for_it(
    radio: Opener,
) -> None:
    endpoint = pick_endpoint()
    train = radio(SessionRole.TRAIN, endpoint)
    train.listen([keys.authorities(LINE, 8)])

    for _ in range(2):
        wayside = radio(SessionRole.WAYSIDE, endpoint)
        assert passes_on(wayside, train, keys.authority(LINE, 0, 8), b"x").payload == b"x"
        wayside.send(CLOCK.now_ns(), keys.authority(LINE, 0, 7), b"for another")
        close_settled(wayside)
        until(lambda: not train.connected)
    assert {each.payload for each in train.receive(CLOCK.now_ns())} <= {b"x"}


def test_a_closed_radio_accepts_new_subscriptions(radio: Opener) -> None:
    endpoint = pick_endpoint()
    wayside, train = radio(SessionRole.WAYSIDE, endpoint), radio(SessionRole.TRAIN, endpoint)
    passes_on(wayside, train, keys.authority(LINE, 0, 7), b"x")
    train.close()
    train.listen([keys.authorities(LINE, 7)])
    wayside.send(CLOCK.now_ns(), keys.authority(LINE, 0, 7), b"y")
    # A message sent before the close may have arrived.
    assert {each.payload for each in train.receive(CLOCK.now_ns())} <= {b"x"}
    assert train.counters.errors == 0


def test_an_unread_inbox_is_bounded_and_counts_dropped_messages(radio: Opener) -> None:
    endpoint = pick_endpoint()
    wayside, train = radio(SessionRole.WAYSIDE, endpoint), radio(SessionRole.TRAIN, endpoint)
    passes_on(train, wayside, keys.report(LINE, 7), b"x")
    before = wayside.counters.received
    key = keys.report(LINE, 7)

    until(lambda: flood(train) or wayside.counters.dropped_in > 0)
    train.send(CLOCK.now_ns(), key, b"last")

    kept = all_until(wayside, b"last", CLOCK.now_ns())

    assert wayside.counters.received - before == len(kept)
    assert len(kept) >= INBOX_MESSAGES


def test_a_radio_may_use_more_keys_than_publishers(radio: Opener) -> None:
    endpoint = pick_endpoint()
    wayside, train = radio(SessionRole.WAYSIDE, endpoint), radio(SessionRole.TRAIN, endpoint)
    passes_on(wayside, train, keys.authority(LINE, 0, 7), b"x")
    for other in range(1000, 1000 + 2 * PUBLISHERS):
        wayside.send(CLOCK.now_ns(), keys.authority(LINE, 0, other), b"other")

    assert passes_on(wayside, train, keys.authority(LINE, 0, 7), b"y").key.endswith("/7")
    assert wayside.counters.errors == 0


def test_a_closed_radio_neither_sends_nor_receives_and_may_be_closed_twice(radio: Opener) -> None:
    endpoint = pick_endpoint()
    wayside = radio(SessionRole.WAYSIDE, endpoint)
    wayside.close()
    wayside.close()
    wayside.send(CLOCK.now_ns(), keys.authority(LINE, 0, 7), b"x")

    assert wayside.counters.dropped_out == 1
    assert not wayside.connected
    assert list(wayside.receive(CLOCK.now_ns())) == []


def test_two_waysides_at_one_endpoint_are_refused_with_its_name(radio: Opener) -> None:
    endpoint = pick_endpoint()
    radio(SessionRole.WAYSIDE, endpoint)

    with pytest.raises(RadioError, match=f"^{endpoint}: in use by another program; .* endpoint$"):
        radio(SessionRole.WAYSIDE, endpoint)


def test_a_port_in_use_by_any_program_is_refused_with_its_name(radio: Opener) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        endpoint = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        with pytest.raises(RadioError, match=f"^{endpoint}: in use by another program"):
            radio(SessionRole.WAYSIDE, endpoint)


@pytest.mark.parametrize(
    ("role", "endpoint", "words"),
    [
        (SessionRole.TRAIN, "nonsense", "it has the form tcp/HOST:PORT"),
        (SessionRole.WAYSIDE, "nonsense", "it has the form tcp/HOST:PORT"),
        (SessionRole.WAYSIDE, "tcp/192.0.2.1:7447", "not an address of this machine"),
        (SessionRole.WAYSIDE, "tcp/no.such.host.invalid:7447", "the host is unknown"),
    ],
)
def test_an_impossible_endpoint_is_refused_with_its_name(
    radio: Opener, role: SessionRole, endpoint: str, words: str
) -> None:
    with pytest.raises(RadioError, match=f"^{endpoint}: .*{words}"):
        radio(role, endpoint)


def test_picked_endpoints_can_be_listened_at(radio: Opener) -> None:
    radio(SessionRole.WAYSIDE, pick_endpoint())
    radio(SessionRole.WAYSIDE, pick_endpoint())


def test_a_program_without_a_radio_does_not_load_zenoh() -> None:
    program = """
import sys
import firmware_py.radio.inproc_radio, firmware_py.radio.zenoh_radio, zenoh_config.codec
sys.exit("zenoh" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", program], timeout=PATIENCE_S).returncode == 0


PROGRAM = """
import signal, sys, time
from firmware_py.clock.clock import WallClock
from firmware_py.radio.zenoh_radio import SessionRole, open_radio, pick_endpoint
def ended(number, frame):
    raise SystemExit(40)
signal.signal(signal.SIGTERM, ended)
clock = WallClock()
endpoint = pick_endpoint()
wayside = open_radio(SessionRole.WAYSIDE, endpoint, ["a/**"], clock)
train = open_radio(SessionRole.TRAIN, endpoint, ["b/**"], clock)
lonely = open_radio(SessionRole.TRAIN, pick_endpoint(), ["b/**"], clock)
while not wayside.receive(clock.now_ns()):
    train.send(clock.now_ns(), "a/1", b"x")
    wayside.send(clock.now_ns(), "b/1", b"y")
    time.sleep(0.002)
print("running", flush=True)
"""


@pytest.mark.parametrize(
    ("ending", "code"),
    [
        ("", 0),
        ("sys.exit(3)", 3),
        ("[radio.close() for radio in (train, wayside, lonely)]", 0),
        ("raise KeyboardInterrupt", -signal.SIGINT),
    ],
    ids=["runs out", "exits", "closes", "interrupted"],
)
def test_a_program_always_ends_closed_or_not(ending: str, code: int) -> None:
    """Known behaviour of zenoh in Python: a program that ends with an open subscriber hangs
    forever."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM + ending],
        timeout=2 * PATIENCE_S,
        capture_output=True,
        text=True,
    )

    assert done.returncode == code, done.stderr
    assert done.stdout == "running\n"


LEFT_OPEN = """
import atexit
from firmware_py.clock.clock import WallClock
from firmware_py.radio.zenoh_radio import SessionRole, open_radio, pick_endpoint
radios = []
# What is registered first is called last: after the radios had their say.
atexit.register(lambda: print([radio.counters.dropped_out for radio in radios]))
atexit.register(lambda: [radio.send(0, "a/1", b"x") for radio in radios])
endpoint = pick_endpoint()
radios.append(open_radio(SessionRole.WAYSIDE, endpoint, ["a/**"], WallClock()))
radios.append(open_radio(SessionRole.TRAIN, endpoint, ["b/**"], WallClock()))
while not radios[1].connected:
    pass
"""


def test_forgotten_radios_are_closed_before_the_program_ends() -> None:
    """Zenoh's threads would call into an ending interpreter and abort the program.

    That happens in at most one of ten programs, so the test does not wait for it. A closed radio
    drops what it gets.
    """
    done = subprocess.run(
        [sys.executable, "-c", LEFT_OPEN], timeout=PATIENCE_S, capture_output=True, text=True
    )

    assert (done.returncode, done.stdout, done.stderr) == (0, "[1, 1]\n", "")


def flood(train: RadioPort) -> bool:
    for _ in range(200):
        train.send(CLOCK.now_ns(), keys.report(LINE, 7), b"flood")
    return False


def test_a_terminated_program_runs_its_own_end() -> None:
    program = PROGRAM + "with train, wayside, lonely:\n    time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == b"running\n"
        running.send_signal(signal.SIGTERM)
        try:
            assert running.wait(timeout=PATIENCE_S) == 40
        finally:
            running.kill()
