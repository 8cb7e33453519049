"""The radio over zenoh: trains are clients of the wayside's session, which is a router, or peers.

Zenoh is transport only. Its messages may be late, duplicated or forged, and "reliable" ones may be
lost. Its threads only stamp each message and put it into a bounded inbox.
"""

import atexit
import contextlib
import socket
import threading
from collections import OrderedDict, deque
from collections.abc import Collection, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final, Protocol, Self

from firmware_py.ports import LinkCounters, RadioMessage
from firmware_py.radio.credentials import Credentials
from zenoh_config.secured import at_endpoint
from zenoh_config.sessions import (
    DEFAULT_ENDPOINT,
    SessionRole,
    address_of,
    check_endpoint,
    session_settings,
)

if TYPE_CHECKING:
    import zenoh

__all__ = [
    "DEFAULT_ENDPOINT",
    "RadioError",
    "SessionRole",
    "ZenohRadio",
    "open_peer",
    "open_radio",
    "pick_endpoint",
]

INBOX_MESSAGES: Final = 256
PUBLISHERS: Final = 256
TOKENS_MAX: Final = 4096
"""Maximum number of other sessions' tokens that are remembered."""
RETRY_S: Final = 0.1
RENEWAL_S: Final = 1.0
"""Period in which the files of certificate and key are looked at."""
CLOSE_S: Final = 3.0
"""Time to wait for the connecting thread; longer than one attempt to connect (train.json5)."""

_REASONS: Final = (
    ("Address already in use", "in use by another program; end that one or take another endpoint"),
    ("Cannot assign requested address", "not an address of this machine"),
    ("failed to lookup address", "the host is unknown"),
    ("Permission denied", "permission denied; ports below 1024 need special rights"),
)


class RadioError(Exception):
    """A radio cannot be opened; the text names the endpoint and what to do."""


class Instants(Protocol):
    def now_ns(self) -> int: ...


def open_radio(
    role: SessionRole,
    endpoint: str,
    subscriptions: Collection[str],
    clock: Instants,
    *,
    inbox_messages: int = INBOX_MESSAGES,
    secure: Credentials | None = None,
    token: str | None = None,
    watched_tokens: str | None = None,
) -> "ZenohRadio":
    """Open a radio.

    A wayside listens at once, or RadioError gives the reason.

    A train's radio returns at once too, connected or not. It keeps trying to connect in the
    background, also after a loss of the wayside. It raises RadioError only for an invalid endpoint.
    If more than `inbox_messages` wait, the oldest are dropped and counted. With credentials the
    session uses TLS, whatever scheme the endpoint names. When certificate and key are renewed, a
    train's radio opens a session with the new ones before it closes the old session.

    Args:
        token: key by which sessions that watch tokens see that this session is alive.
        watched_tokens: key expression of the tokens that `present` reports.
    """
    try:
        check_endpoint(endpoint)
        if secure is None:
            settings = session_settings(role, endpoint)
        else:
            settings = at_endpoint(secure.settings, endpoint)
    except ValueError as error:
        raise RadioError(str(error)) from error
    return ZenohRadio(
        *(role, endpoint, settings, subscriptions, clock, inbox_messages),
        token=token,
        watched_tokens=watched_tokens,
        files=() if secure is None else secure.files,
    )


def open_peer(
    endpoint: str,
    listens_at: str | None,
    subscriptions: Collection[str],
    clock: Instants,
    *,
    token: str | None = None,
) -> "ZenohRadio":
    """Open a train's radio that reaches other peers directly, without the wayside in between.

    The wayside at `endpoint` introduces peers to each other once. Peers that know each other
    continue to communicate after it is gone. By default other peers reach this one at the address
    by which it reaches the wayside, at any port. RadioError names an invalid endpoint, or why it
    cannot listen there.
    """
    try:
        check_endpoint(endpoint)
        settings = session_settings(
            SessionRole.PEER, endpoint, listens_at or _own_endpoint(endpoint)
        )
    except ValueError as error:
        raise RadioError(str(error)) from error
    return ZenohRadio(
        *(SessionRole.PEER, listens_at or endpoint, settings, subscriptions, clock), token=token
    )


def _own_endpoint(endpoint: str) -> str:
    """Return this machine's address on the route to another one; nothing is sent."""
    try:
        kind, _, _, _, address = socket.getaddrinfo(*address_of(endpoint), type=socket.SOCK_DGRAM)[
            0
        ]
        with socket.socket(kind, socket.SOCK_DGRAM) as probe:
            probe.connect(address)
            host: str = probe.getsockname()[0]
    except OSError as error:
        raise RadioError(
            f"{endpoint}: the address of this machine on the route to it is unknown "
            f"({error.strerror}); give the endpoint to listen at"
        ) from error
    return f"tcp/[{host}]:0" if kind == socket.AF_INET6 else f"tcp/{host}:0"


def pick_endpoint() -> str:
    """Return an endpoint on this machine that is free at this moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


class _Opened:
    """An open session with what is declared on it."""

    def __init__(self, session: "zenoh.Session") -> None:
        self.session = session
        self.publishers: OrderedDict[str, zenoh.Publisher] = OrderedDict()
        self.subscribers: dict[str, zenoh.Subscriber[None]] = {}
        """Declared subscribers, by key expression."""
        self.declared: list[object] = []
        """The token and the subscriber to other tokens; zenoh undeclares them when they are
        garbage-collected."""

    def close(self) -> None:
        self.session.close()  # type: ignore[no-untyped-call]


class ZenohRadio:
    """A radio session; close it, or leave its `with`, when done. Counters count messages."""

    def __init__(
        self,
        role: SessionRole,
        endpoint: str,
        settings: str,
        subscriptions: Collection[str],
        clock: Instants,
        inbox_messages: int = INBOX_MESSAGES,
        *,
        token: str | None = None,
        watched_tokens: str | None = None,
        files: Sequence[Path] = (),
    ) -> None:
        # Imported here because lockstep runs do not use zenoh and should not wait for its import.
        import zenoh

        self.counters = LinkCounters()
        self.renewals = 0
        """Number of sessions opened with renewed certificate and key."""
        self.endpoint = endpoint
        self._zenoh = zenoh
        self._config = zenoh.Config.from_json5(settings)
        self._wanted = {wanted: zenoh.KeyExpr(wanted) for wanted in subscriptions}
        self._token, self._watched_tokens, self._files = token, watched_tokens, files
        self._present: set[str] = set()
        self._tuning = threading.Lock()
        self._clock, self._inbox_messages = clock, inbox_messages
        self._opened: _Opened | None = None
        self._inbox: deque[RadioMessage] = deque()
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._connector: threading.Thread | None = None
        if role is not SessionRole.TRAIN:
            self._listen()
        else:
            self._connector = threading.Thread(target=self._connect, name="radio", daemon=True)
            self._connector.start()
        # Stop the connecting thread before the interpreter shuts down; otherwise it would crash the
        # process.
        atexit.register(self.close)

    @property
    def connected(self) -> bool:
        """Whether the wayside is connected; for a wayside or a peer, whether any other session is.

        Takes about 20 µs.
        """
        opened = self._opened
        if opened is None:
            return False
        return bool(opened.session.info.transports())

    @property
    def present(self) -> frozenset[str]:
        """Tokens of other live sessions as far as this one knows; not for safety decisions."""
        with self._lock:
            return frozenset(self._present)

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        opened = self._opened
        if opened is None:
            self.counters.dropped_out += 1
            return
        try:
            self._publisher(opened, key).put(payload)
        except self._zenoh.ZError:
            self.counters.errors += 1
            self.counters.dropped_out += 1
        else:
            self.counters.sent += 1

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        """Return the messages since the last call, stamped on arrival but never later than now."""
        if not self._inbox:
            return ()
        with self._lock:
            heard, self._inbox = self._inbox, deque()
        self.counters.received += len(heard)
        return [
            message if message.stamp_ns <= now_ns else message._replace(stamp_ns=now_ns)
            for message in heard
        ]

    def listen(self, subscriptions: Collection[str]) -> None:
        """Change the subscriptions; a session that is not connected yet starts with them."""
        expression = self._zenoh.KeyExpr
        with self._tuning:
            self._wanted = {wanted: expression(wanted) for wanted in subscriptions}
            if self._opened is not None:
                try:
                    self._tune(self._opened)
                except self._zenoh.ZError:
                    self.counters.errors += 1

    def close(self) -> None:
        atexit.unregister(self.close)
        self._closing.set()
        if self._connector is not None:
            self._connector.join(CLOSE_S)
        opened, self._opened = self._opened, None
        if opened is not None:
            with contextlib.suppress(self._zenoh.ZError):
                opened.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _listen(self) -> None:
        try:
            self._begin()
        except self._zenoh.ZError as error:
            raise RadioError(f"{self.endpoint}: {_reason(str(error))}") from error

    def _connect(self) -> None:
        """Try until a session is open, and again when certificate and key are renewed.

        Zenoh itself connects an open session again after a loss.
        """
        used = None
        while not self._closing.is_set():
            found = self._versions()
            wait_s = RENEWAL_S
            if found != used:
                try:
                    self._begin()
                except self._zenoh.ZError:
                    self.counters.errors += 1
                    wait_s = RETRY_S
                else:
                    used = found
                    if not self._files:
                        return
            self._closing.wait(wait_s)

    def _versions(self) -> list[tuple[int, int]]:
        """Return what changes when one of the files is written again."""
        found = []
        for path in self._files:
            with contextlib.suppress(OSError):
                state = path.stat()
                found.append((state.st_mtime_ns, state.st_ino))
        return found

    def _begin(self) -> None:
        """Open a session, and close the one before it."""
        opened = _Opened(self._zenoh.open(self._config))
        with self._tuning:
            try:
                self._tune(opened)
                self._declare(opened)
            except self._zenoh.ZError:
                # Closing the session removes what was declared; the next session declares it again.
                opened.close()
                raise
            before, self._opened = self._opened, opened
        if before is not None:
            self.renewals += 1
            with contextlib.suppress(self._zenoh.ZError):
                before.close()

    def _tune(self, opened: _Opened) -> None:
        """Declare the wanted subscriptions on the session and remove all others."""
        zenoh, subscribers = self._zenoh, opened.subscribers
        for wanted in [each for each in self._wanted if each not in subscribers]:
            # zenoh's own thread calls it. With a Python thread in between, a program that ends
            # without closing would hang.
            take = zenoh.handlers.Callback(self._take, indirect=False)
            subscribers[wanted] = opened.session.declare_subscriber(
                self._wanted[wanted], take, allowed_origin=zenoh.Locality.REMOTE
            )
        for left in [each for each in subscribers if each not in self._wanted]:
            subscribers.pop(left).undeclare()  # type: ignore[no-untyped-call]

    def _declare(self, opened: _Opened) -> None:
        liveliness = opened.session.liveliness()
        if self._token is not None:
            opened.declared.append(liveliness.declare_token(self._token))
        if self._watched_tokens is not None:
            see = self._zenoh.handlers.Callback(self._see, indirect=False)
            opened.declared.append(
                liveliness.declare_subscriber(self._watched_tokens, see, history=True)
            )

    def _see(self, sample: "zenoh.Sample") -> None:
        key = str(sample.key_expr)
        with self._lock:
            if sample.kind != self._zenoh.SampleKind.PUT:
                self._present.discard(key)
            elif len(self._present) < TOKENS_MAX:
                self._present.add(key)

    def _take(self, sample: "zenoh.Sample") -> None:
        message = RadioMessage(
            self._clock.now_ns(), str(sample.key_expr), sample.payload.to_bytes()
        )
        with self._lock:
            if len(self._inbox) >= self._inbox_messages:
                self._inbox.popleft()
                self.counters.dropped_in += 1
            self._inbox.append(message)

    def _publisher(self, opened: _Opened, key: str) -> "zenoh.Publisher":
        publisher = opened.publishers.get(key)
        if publisher is None:
            import zenoh

            # DROP, because a hanging receiver must never delay the others.
            publisher = opened.session.declare_publisher(
                key,
                express=True,
                priority=zenoh.Priority.REAL_TIME,
                congestion_control=zenoh.CongestionControl.DROP,
                reliability=zenoh.Reliability.BEST_EFFORT,
            )
            opened.publishers[key] = publisher
            if len(opened.publishers) > PUBLISHERS:
                _, oldest = opened.publishers.popitem(last=False)
                oldest.undeclare()  # type: ignore[no-untyped-call]
        return publisher


def _reason(text: str) -> str:
    """Zenoh's error text contains paths of its build; users need the cause only."""
    return next((words for part, words in _REASONS if part in text), text.partition(" at /")[0])
