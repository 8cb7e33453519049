"""Serves the page of a line: its state ten times a second, events, and commands where allowed."""

import asyncio
import sys
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Final, Literal

import msgspec

from canlog.live.server import Connection, Item, TokenServer, Viewer, serve_viewer
from canlog.views.serving import LOOPBACK, PAGE
from metro_hil.model.run_options import EXIT_OK, LINE_VERBS
from metro_hil.supervision.view import LineView
from metro_hil.watch.bench_page import bench_page
from metro_hil.watch.line_picture import LinePicture, changes, picture_of
from metro_hil.watch.line_source import FolderSource, LineSource

VERSION: Final = 1
LOOK_NS: Final = 90_000_000
"""Least time between two states that the viewers get: ten a second, at twenty ticks."""
SAMPLE_NS: Final = 1_000_000_000
SAMPLES_MAX: Final = 1800
"""Points of the time-distance graph that a new viewer gets: half an hour, one a second."""
EVENTS_MAX: Final = 500
COMMANDS: Final = {
    verb: words for verb, words in LINE_VERBS.items() if verb not in ("line", "master")
}


class PageCommand(msgspec.Struct, forbid_unknown_fields=True):
    """A command of supervision that a viewer confirmed."""

    verb: Literal[
        "switch-master",
        "out-of-service",
        "remove-train",
        "hold",
        "skip",
        "emergency-brake",
        "restrict",
        "close",
    ]
    train: int = 0
    area: int = 0
    start_m: float = 0.0
    end_m: float = 0.0
    limit_kmh: float | None = None
    end: bool = False
    """Takes the command back."""

    def words(self) -> list[str]:
        """Return the words of `vobc`. Numbers only, so that a viewer cannot add an option."""
        back = ["--end"] if self.end else []
        if self.verb == "switch-master":
            return [self.verb, "--area", str(self.area), "--to", f"T{self.train}"]
        if self.verb == "remove-train":
            return [self.verb, f"T{self.train}"]
        if self.verb not in ("restrict", "close"):
            return [self.verb, f"T{self.train}", *back]
        words = [self.verb, f"{self.start_m:.12g}", f"{self.end_m:.12g}"]
        if self.verb == "restrict" and self.limit_kmh is not None and not self.end:
            words += ["--limit", f"{self.limit_kmh:.12g}"]
        return [*words, *back]


class LineServer(TokenServer):
    """Receives the radio of a line or reads its log, and shows the line to all viewers.

    It has no way to send on a session. A command runs as a process of the command line.
    """

    def __init__(
        self,
        view: LineView,
        source: LineSource,
        head: Mapping[str, Any],
        *,
        command_line: Sequence[str] | None = None,
        listen: str = LOOPBACK,
        port_number: int = 0,
    ) -> None:
        """Listen. Raises LogError if the port is taken or not allowed.

        Args:
            head: what `line_picture.head_of` returns.
            command_line: options of the line for each command; None for a page that only shows.
        """
        super().__init__(host=listen, port=port_number)
        self._view, self._source = view, source
        self._command_line = command_line
        self._head = {
            **head,
            "kind": "snapshot",
            "version": VERSION,
            "commands": {} if command_line is None else COMMANDS,
            "of_run": isinstance(source, FolderSource),
        }
        self._viewers: set[Viewer] = set()
        self._now_ns = self._looked_ns = self._sampled_ns = 0
        self._picture: LinePicture = picture_of(view, 0, connected=source.connected)
        self._told = ("", "", "")
        self._new_samples: list[list[Any]] = []
        self._samples: deque[list[Any]] = deque(maxlen=SAMPLES_MAX)
        self._events: deque[dict[str, Any]] = deque(maxlen=EVENTS_MAX)
        self._news: list[dict[str, Any]] = []
        """Events that the viewers do not have yet."""
        self._command: asyncio.Task[None] | None = None
        """The command that goes on."""
        self._busy = ""
        self._page = bench_page("line").encode()

    def answer(self, path: str, query: Mapping[str, str]) -> tuple[str, bytes] | None:
        del query
        return (PAGE, self._page) if path == "" else None

    def tick(self) -> None:
        looked = False
        for now_ns, messages, notes in self._source.steps():
            self._now_ns = now_ns
            self._view.on_message(messages, now_ns)
            for at_s, text in notes:
                self._note("run", text, at_s)
            if now_ns - self._looked_ns >= LOOK_NS:
                self._look(now_ns)
                looked = True
        if looked or self._news or self._told != self._short():
            self._offer()

    def _look(self, now_ns: int) -> None:
        """Find the events since the last state."""
        before, self._looked_ns = self._picture, now_ns
        self._picture = picture_of(self._view, now_ns, connected=self._source.connected)
        latest = [each["text"] for each in self._news]
        for text in changes(before, self._picture):
            # The event log of a run has some of them, too.
            if text not in latest:
                self._note("line", text)
        if now_ns - self._sampled_ns >= SAMPLE_NS:
            self._sampled_ns = now_ns
            places = [[t.train, t.front_max_m] for t in self._picture.trains if _has_place(t)]
            self._samples.append([self._shown_s(), places])
            self._new_samples.append(self._samples[-1])

    def _offer(self) -> None:
        """Offer the state and what is new to all viewers."""
        told = {"kind": "news", **self._state(), "events": self._news}
        if self._new_samples:
            told["samples"] = self._new_samples
        self._told = self._short()
        self._news, self._new_samples = [], []
        text = _text(told)
        for viewer in self._viewers:
            viewer.offer([text])

    def _state(self) -> dict[str, Any]:
        return {
            "now": self._shown_s(),
            "state": self._picture,
            "busy": self._busy,
            "remark": self._source.remark,
            "ended": self._source.results.text,
            "results": self._source.results.trains,
        }

    def _short(self) -> tuple[str, str, str]:
        """Return what may change while the line itself stands still."""
        return self._busy, self._source.remark, self._source.results.text

    def _shown_s(self) -> float:
        return self._source.shown_s(self._now_ns)

    def _note(self, kind: str, text: str, at_s: float | None = None) -> None:
        """Add an event that happened now or at an instant of the past."""
        event = {"at": self._shown_s() if at_s is None else at_s, "kind": kind, "text": text}
        self._events.append(event)
        self._news.append(event)

    async def stream(self, connection: Connection) -> None:
        past = {"events": [*self._events], "samples": [*self._samples]}
        viewer = Viewer([_text({**self._head, **self._state(), **past})])
        self._viewers.add(viewer)
        try:
            await serve_viewer(connection, viewer, self._on_message)
        finally:
            self._viewers.discard(viewer)

    def _on_message(self, message: Item) -> None:
        """Start a command; anything else is dropped, and everything on a page that only shows."""
        if self._command_line is None or self._command is not None:
            return
        try:
            command = msgspec.json.decode(message, type=PageCommand)
        except msgspec.MsgspecError:
            return
        words = command.words()
        self._busy = " ".join(["vobc", *words])
        self._command = asyncio.ensure_future(self._obey([*words, *self._command_line]))

    async def _obey(self, words: Sequence[str]) -> None:
        """Run the command line, and make its output an event."""
        try:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "metro_hil.cli.vobc", *words),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT,
            )
            try:
                printed, _ = await process.communicate()
            finally:
                if process.returncode is None:
                    process.kill()
            kind = "done" if process.returncode == EXIT_OK else "refused"
            self._note(kind, f"{self._busy}: {_joined(printed.decode(errors='replace'))}")
        except OSError as error:
            self._note("refused", f"{self._busy}: {error.strerror}")
        finally:
            self._busy, self._command = "", None

    def close(self) -> None:
        if self._command is not None:
            self._command.cancel()


def _has_place(train: Any) -> bool:
    return bool(train.localised and not train.silence)


def _joined(printed: str) -> str:
    """Return the output of a command as one line, without the program's name."""
    return "; ".join([line.removeprefix("vobc: ") for line in printed.splitlines() if line])


def _text(told: Mapping[str, Any]) -> str:
    return msgspec.json.encode(told).decode()
