"""Serves the live page to browsers, and the stream to each over a WebSocket.

Each viewer has a queue of limited length. A viewer who reads too slowly loses updates and learns
how many; neither the feed nor another viewer ever waits for it.
"""

import asyncio
import json
import secrets
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from http import HTTPStatus
from typing import Any, Final, Protocol
from urllib.parse import parse_qsl, urlsplit

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from canlog.damage import LogError
from canlog.live.feeds import Feed
from canlog.live.stream import History
from canlog.views.serving import LOOPBACK, PAGE, POLICY

PERIOD_S: Final = 0.05
"""Time between two updates: 20 a second."""
QUEUE_MESSAGES: Final = 100
"""Messages that wait for one viewer, at most: some seconds of updates."""
PLAIN: Final = "text/plain; charset=utf-8"
ANY: Final = ("0.0.0.0", "::")  # noqa: S104

Item = str | bytes
Connection = ServerConnection
"""Connection of one viewer, for servers outside of this package."""


class Viewer:
    """One browser, and what waits for it."""

    def __init__(self, first: list[Item]) -> None:
        self._waiting: asyncio.Queue[Item] = asyncio.Queue()
        self._most = len(first) + QUEUE_MESSAGES
        self.lost = 0
        """Messages that this viewer lost since it last got one."""
        for item in first:
            self._waiting.put_nowait(item)

    def offer(self, items: list[Item]) -> None:
        """Queue the items; without room all of them are lost to this viewer."""
        if self._waiting.qsize() + len(items) > self._most:
            self.lost += len(items)
            return
        if self.lost:
            self._waiting.put_nowait(json.dumps({"kind": "lost", "messages": self.lost}))
            self.lost = 0
        for item in items:
            self._waiting.put_nowait(item)

    async def next(self) -> Item:
        return await self._waiting.get()


class TokenServer(ABC):
    """Serves pages at one address with a token, for as long as `run` runs."""

    def __init__(self, *, host: str = LOOPBACK, port: int = 0) -> None:
        """Listen. Raises LogError if the port is taken or not allowed; 0 takes a free one."""
        self._host = host
        self._token = secrets.token_urlsafe(16)
        try:
            self._socket = socket.create_server(
                (host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET
            )
        except (OSError, OverflowError) as error:
            why = getattr(error, "strerror", None) or "has to be from 0 to 65535"
            raise LogError(f"{host}, --port {port}: {why}") from error
        self._port = int(self._socket.getsockname()[1])

    @property
    def address(self) -> str:
        name = socket.gethostname() if self._host in ANY else self._host
        shown = f"[{name}]" if ":" in name else name
        return f"http://{shown}:{self._port}/{self._token}/"

    @abstractmethod
    def answer(self, path: str, query: Mapping[str, str]) -> tuple[str, bytes] | None:
        """Return media type and content of a path below the address; None if it is unknown.

        It is called in a thread. Raises LogError, whose text the viewer then gets.
        """

    def tick(self) -> None:  # noqa: B027
        """Called 20 times a second."""

    async def stream(self, connection: ServerConnection) -> None:
        """Serve one viewer of the stream; without a stream the viewer is turned away."""
        await connection.close()

    async def run(self) -> None:
        """Serve until the task is cancelled."""
        # Browsers also open connections that they never use. Waiting for them, as `async with`
        # does, would hold up the end by ten seconds.
        server = await serve(
            self.stream,
            sock=self._socket,
            process_request=self._answer,
            open_timeout=None,
            compression=None,
            server_header=None,
            max_size=1 << 16,
        )
        try:
            while True:
                self.tick()
                await asyncio.sleep(PERIOD_S)
        finally:
            server.close()
            self.close()

    def close(self) -> None:  # noqa: B027
        """Called once at the end."""

    async def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer one request for a file; None lets the request for the stream pass."""
        del connection
        if not self._is_named(request.headers.get("Host", "")):
            return _response(HTTPStatus.FORBIDDEN, PLAIN, b"unknown host name\n")
        asked = urlsplit(request.path)
        below = asked.path.removeprefix(f"/{self._token}/")
        if below == asked.path:
            words = "The address lacks its token; take the whole address that the program printed."
            return _response(HTTPStatus.NOT_FOUND, PLAIN, f"{words}\n".encode())
        if below == "stream":
            origin = request.headers.get("Origin", "")
            if urlsplit(origin).netloc != request.headers.get("Host"):
                return _response(HTTPStatus.FORBIDDEN, PLAIN, b"a page of another site\n")
            return None
        query = dict(parse_qsl(asked.query, keep_blank_values=True))
        try:
            found = await asyncio.to_thread(self.answer, below, query)
        except LogError as error:
            return _response(HTTPStatus.BAD_REQUEST, PLAIN, f"{error}\n".encode())
        if found is None:
            return _response(HTTPStatus.NOT_FOUND, PLAIN, b"unknown path\n")
        return _response(HTTPStatus.OK, *found)

    def _is_named(self, host: str) -> bool:
        """Whether a page of another site cannot have made the request by a name of its own."""
        if self._host in ANY:
            return True
        shown = f"[{self._host}]" if ":" in self._host else self._host
        return host in (f"{shown}:{self._port}", f"localhost:{self._port}")


class DeskControl(Protocol):
    """A desk that one viewer at a time may use."""

    @property
    def keys(self) -> Sequence[tuple[str, str]]:
        """Name and description of each key."""
        ...

    def press(self, key: str) -> None: ...

    def let_go(self) -> None:
        """The viewer who held the desk is gone."""
        ...

    def close(self) -> None: ...


class FaultControl(Protocol):
    """Faults that one viewer at a time may start, change and stop."""

    @property
    def catalogue(self) -> Sequence[Mapping[str, Any]]:
        """The faults by place, for the page."""
        ...

    def act(self, message: Mapping[str, Any]) -> str:
        """Do what a viewer wants; return why it is impossible, or an empty text."""
        ...

    def news(self) -> Sequence[Mapping[str, Any]] | None:
        """Return all faults that began, if there is something new; else None."""
        ...

    def close(self) -> None: ...


class LiveServer(TokenServer):
    """The live page, and its stream."""

    def __init__(
        self,
        feed: Feed,
        history: History,
        page: Callable[[], str],
        *,
        now_ns: Callable[[], int],
        hands: DeskControl | None = None,
        faults: FaultControl | None = None,
        host: str = LOOPBACK,
        port: int = 0,
    ) -> None:
        """Listen. Raises LogError if the port is taken or not allowed.

        Args:
            page: returns the page as HTML; called for each viewer, in a thread.
            now_ns: reads the wall clock, in nanoseconds since 1970.
            hands: the desk that viewers may use; None for a page without a desk.
            faults: the faults on which viewers may act; None if they may not.
        """
        super().__init__(host=host, port=port)
        self._feed, self._history, self._page, self._now_ns = feed, history, page, now_ns
        self._hands, self._faults = hands, faults
        self._began: Sequence[Mapping[str, Any]] = ()
        """Faults that began so far."""
        self._holder: Viewer | None = None
        """The viewer who has the desk and the faults."""
        self._viewers: set[Viewer] = set()

    def answer(self, path: str, query: Mapping[str, str]) -> tuple[str, bytes] | None:
        return (PAGE, self._page().encode()) if path == "" else None

    def tick(self) -> None:
        """Pass the news of the feed on to all viewers."""
        if self._history.ended:
            return
        items = self._history.take(self._feed.poll(self._now_ns()))
        if self._faults is not None and (began := self._faults.news()) is not None:
            self._began = began
            items.append(_faults_text(began))
        if items:
            for viewer in self._viewers:
                viewer.offer(items)

    def close(self) -> None:
        self._feed.close()
        for control in (self._hands, self._faults):
            if control is not None:
                control.close()

    async def stream(self, connection: ServerConnection) -> None:
        viewer = Viewer(self._history.snapshot())
        self._viewers.add(viewer)
        if self._holder is not None:
            viewer.offer([json.dumps({"kind": "desk", "holder": "another"})])
        if self._began:
            viewer.offer([_faults_text(self._began)])
        try:
            await serve_viewer(connection, viewer, lambda message: self._hear(viewer, message))
        finally:
            self._viewers.discard(viewer)
            self._drop(viewer)

    def _hear(self, viewer: Viewer, message: Item) -> None:
        """Do what the viewer who has the desk and the faults wants; drop anything else."""
        if self._history.ended:
            return
        try:
            told = json.loads(message)
            kind, key = told.get("kind"), told.get("key")
        except (ValueError, AttributeError):
            return
        if kind == "fault":
            if why := self._act_on_fault(viewer, told):
                viewer.offer([json.dumps({"kind": "refused", "why": why})])
        elif self._hands is None and self._faults is None:
            return
        elif kind == "take" and self._holder in (None, viewer):
            self._holder = viewer
            self._tell_holder()
        elif kind == "leave":
            self._drop(viewer)
        elif kind == "key" and viewer is self._holder:
            self._press(key)

    def _press(self, key: Any) -> None:
        if self._hands is not None and key in dict(self._hands.keys):
            self._hands.press(key)

    def _act_on_fault(self, viewer: Viewer, told: Mapping[str, Any]) -> str:
        """Return why the act is refused; empty if the bench takes it."""
        if self._faults is None:
            return "This run takes no faults by hand; start it with --allow-faults."
        if viewer is not self._holder:
            return "Take the faults first; one viewer at a time acts."
        return self._faults.act(told)

    def _drop(self, viewer: Viewer) -> None:
        """Free desk and faults if this viewer has them; faults that act go on."""
        if viewer is self._holder:
            self._holder = None
            if self._hands is not None:
                self._hands.let_go()
            self._tell_holder()

    def _tell_holder(self) -> None:
        for each in self._viewers:
            who = "you" if each is self._holder else "another" if self._holder else ""
            each.offer([json.dumps({"kind": "desk", "holder": who})])


def _faults_text(began: Sequence[Mapping[str, Any]]) -> str:
    return json.dumps({"kind": "faults", "began": began})


async def serve_viewer(
    connection: ServerConnection, viewer: Viewer, on_message: Callable[[Item], None]
) -> None:
    """Send what waits for a viewer, and pass its messages on, until it leaves."""
    sending = asyncio.ensure_future(_send(connection, viewer))
    try:
        async for message in connection:
            on_message(message)
    except ConnectionClosed:
        pass
    finally:
        sending.cancel()
        with suppress(asyncio.CancelledError, ConnectionClosed):
            await sending


async def _send(connection: ServerConnection, viewer: Viewer) -> None:
    while True:
        await connection.send(await viewer.next())


def _response(status: HTTPStatus, kind: str, content: bytes) -> Response:
    headers = Headers(
        [
            ("Content-Type", kind),
            ("Content-Length", str(len(content))),
            ("Content-Security-Policy", POLICY),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
            ("Cache-Control", "no-store"),
            ("Connection", "close"),
        ]
    )
    return Response(status.value, status.phrase, headers, content)
