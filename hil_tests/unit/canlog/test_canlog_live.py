"""The live page: feeds that follow a run or a bus, the stream, slow viewers, who may connect."""

import asyncio
import json
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Final
from urllib.error import HTTPError, URLError
from urllib.request import Request, urlopen

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from canlog.command import main as canlog
from canlog.database import own_bus
from canlog.frames import Frames, blank
from canlog.live import stream
from canlog.live.feeds import BusFeed, FolderFeed, News
from canlog.live.page import serve_folder
from canlog.live.server import QUEUE_MESSAGES, LiveServer, Viewer
from canlog.live.stream import History
from canlog.views.place import doubts_of
from firmware_py.ports import CanFrame, LinkCounters
from hil_tests import serving_rig
from hil_tests.unit.canlog import canlog_rig as rig

S: Final = 1_000_000_000
FIRST_NS: Final = 1_800_000_000 * S
BRAKE_CMD: Final = "101#E8530047C6"


def line(at_s: float, words: str = BRAKE_CMD) -> str:
    return f"({FIRST_NS / S + at_s:.6f}) vcan0 {words}\n"


def event(t_s: float, kind: str) -> str:
    return json.dumps({"t_s": t_s, "kind": kind, "words": "why", "sources": []}) + "\n"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    return folder


def unpacked(message: str | bytes) -> tuple[list[float], list[int], list[bytes]]:
    """Instants, numbers of messages and data of one binary message, read field by field."""
    assert isinstance(message, bytes)
    count, width, _, _ = struct.unpack_from("<4I", message)
    at = 16
    instants = list(struct.unpack_from(f"<{count}d", message, at))
    at += 8 * count
    numbers = list(struct.unpack_from(f"<{count}H", message, at))
    at += 4 * count
    lengths = message[at : at + count]
    at += count
    rows = [message[at + width * row :][: lengths[row]] for row in range(count)]
    assert len(message) == at + width * count
    return instants, numbers, rows


def test_a_feed_follows_lines_that_are_written_in_pieces(run: Path) -> None:
    feed = FolderFeed(run, own_bus())
    assert not len(feed.poll(FIRST_NS).frames)
    log = (run / "bus.log").open("w")
    text = line(0.0) + line(0.1, "185#0011223344556677") + line(0.2)

    found = []
    for cut in (5, 60, len(text)):
        log.write(text[log.tell() : cut])
        log.flush()
        found.append(feed.poll(FIRST_NS).frames)

    whole = [row.payload(0).hex() for row in found if len(row)]
    assert [len(each) for each in found] == [0, 1, 2]
    assert whole == ["e8530047c6", "0011223344556677"]
    feed.close()


def test_events_count_from_the_first_frame_of_the_controller(run: Path) -> None:
    feed = FolderFeed(run, own_bus())
    (run / "events.jsonl").write_text(event(0.0, "MODE") + "torn {\n" + event(1.5, "OVERRUN"))
    (run / "bus.log").write_text(line(0.0, "185#0011223344556677"))
    assert feed.poll(FIRST_NS).happenings == ()

    with (run / "bus.log").open("a") as log:
        log.write(line(4.0))
    found = feed.poll(FIRST_NS).happenings

    assert [(each.kind, each.at_ns - FIRST_NS) for each in found] == [
        ("MODE", 4 * S),
        ("OVERRUN", 4 * S + 3 * S // 2),
    ]
    feed.close()


def test_a_run_is_over_when_its_results_are_there(run: Path) -> None:
    (run / "bus.log").write_text(line(0.0))
    (run / "results.json").write_text("{}")
    feed = FolderFeed(run, own_bus())

    first, second = feed.poll(FIRST_NS), feed.poll(FIRST_NS)

    assert (len(first.frames), first.ended) == (1, False)
    assert (second.ended, second.remark) == (True, "")
    feed.close()


def test_a_run_that_was_killed_is_over_after_ten_seconds(run: Path) -> None:
    (run / "bus.log").write_text(line(0.0))
    changed_ns = (run / "bus.log").stat().st_mtime_ns
    feed = FolderFeed(run, own_bus())
    feed.poll(changed_ns)

    alive = feed.poll(changed_ns + 10 * S)
    dead = feed.poll(changed_ns + 10 * S + 1)

    assert not alive.ended
    assert dead.ended
    assert "it was killed, or its disk is full" in dead.remark
    feed.close()


def test_a_folder_that_goes_away_is_told(run: Path) -> None:
    (run / "bus.log").write_text(line(0.0))
    feed = FolderFeed(run, own_bus())
    feed.poll(FIRST_NS)

    (run / "bus.log").unlink()

    assert "is gone" in feed.poll(FIRST_NS).remark
    feed.close()


class OneBus:
    """A port with a few frames whose link breaks."""

    def __init__(self, frames: Sequence[CanFrame]) -> None:
        self.frames, self.alive, self.counters = list(frames), True, LinkCounters()

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        raise AssertionError("a viewer never sends")

    def receive(self, now_ns: int) -> list[CanFrame]:
        found, self.frames = self.frames, []
        return found

    def close(self) -> None:
        self.alive = False


def test_a_bus_that_goes_away_is_told_until_it_is_back() -> None:
    port = OneBus([CanFrame(5, 0x101, b"\1\2"), CanFrame(6, 0x1ABCDEF, b"", extended=True)])
    feed = BusFeed(port, "socketcan:can0", FIRST_NS)

    here = feed.poll(FIRST_NS + 7)
    port.alive = False
    away = feed.poll(FIRST_NS + 8)
    port.alive = True

    assert here.frames.at_ns.tolist() == [FIRST_NS + 5, FIRST_NS + 6]
    assert here.frames.key.tolist() == [0x101, 0x81ABCDEF]
    assert (away.remark, away.ended) == (
        "The bus socketcan:can0 went away; its last frames are shown.",
        False,
    )
    assert feed.poll(FIRST_NS + 9).remark == ""


def frames_of(count: int, first: int = 0) -> Frames:
    frames = blank(count)
    frames.at_ns[:] = FIRST_NS + np.arange(first, first + count) * 1000
    frames.identifier[:] = 0x101
    frames.length[:] = 2
    frames.data[:, 0] = np.arange(first, first + count) % 251
    return frames


def test_the_stream_carries_every_byte_and_names_unknown_messages() -> None:
    frames = rig.random_frames(500)
    history = History(rig.bus())
    known = len(history.heads)

    text, binary = history.take(News(frames))

    told = json.loads(text)
    instants, numbers, rows = unpacked(binary)
    assert int(told["zero"]) == (0 if frames.at_ns[0] < 10**17 else int(frames.at_ns[0]))
    assert [int(told["zero"]) + round(t) for t in instants] == frames.at_ns.tolist()
    assert [history.heads[number]["id"] for number in numbers] == frames.identifier.tolist()
    assert rows == [frames.data[row, : frames.length[row]].tobytes() for row in range(len(frames))]
    assert [each["name"] for each in told.get("messages", [])] == [
        each["name"] for each in history.heads[known:]
    ]


def test_a_new_viewer_gets_the_newest_frames_up_to_a_bound(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stream, "HISTORY_FRAMES", 1000)
    history = History(own_bus())
    for number in range(300):
        history.take(News(frames_of(7, 7 * number)))

    head, *binary = history.snapshot()

    assert json.loads(head)["version"] == stream.VERSION
    instants = [t for each in binary for t in unpacked(each)[0]]
    assert instants == [1000.0 * k for k in range(1100, 2100)]


def test_a_slow_viewer_loses_updates_and_is_told_how_many() -> None:
    async def told() -> list[str | bytes]:
        viewer = Viewer(["snapshot"])
        for number in range(QUEUE_MESSAGES + 5):
            viewer.offer([f"news {number}"])
        found = [await viewer.next() for _ in range(QUEUE_MESSAGES + 1)]
        viewer.offer(["fresh"])
        return [*found, await viewer.next(), await viewer.next()]

    found = asyncio.run(told())

    assert found[: QUEUE_MESSAGES + 1] == [
        "snapshot",
        *(f"news {k}" for k in range(QUEUE_MESSAGES)),
    ]
    assert json.loads(found[-2]) == {"kind": "lost", "messages": 5}
    assert found[-1] == "fresh"


class PressedKeys:
    """Hands that note what was pressed."""

    keys = (("up", "lever up"), ("e", "EMERGENCY button"))

    def __init__(self) -> None:
        self.pressed: list[str] = []

    def press(self, key: str) -> None:
        self.pressed.append(key)

    def let_go(self) -> None:
        self.pressed.append("let go")

    def close(self) -> None:
        self.pressed.append("closed")


@pytest.fixture
def hands() -> PressedKeys:
    return PressedKeys()


@pytest.fixture
def served(run: Path, hands: PressedKeys) -> Iterator[LiveServer]:
    (run / "bus.log").write_text(line(0.0))
    server = serve_folder(run, hands=hands, host="127.0.0.1", port=0)
    with serving_rig.served(server):
        yield server


def test_a_page_of_the_server_gets_the_stream_and_others_get_nothing(served: LiveServer) -> None:
    address = served.address
    own = address.split("/")[2]
    stream_address = address.replace("http", "ws") + "stream"

    with connect(stream_address, origin=Origin(f"http://{own}")) as socket:
        snapshot = json.loads(socket.recv())
        assert unpacked(socket.recv())[2] == [bytes.fromhex("E8530047C6")]
    page = urlopen(address)  # noqa: S310

    assert snapshot["kind"] == "snapshot"
    assert b"VOBC_MOTION" in page.read()
    assert "default-src 'none'" in page.headers["Content-Security-Policy"]
    for origin in (Origin("http://evil.example"), None):
        with pytest.raises(InvalidStatus, match="403"):
            connect(stream_address, origin=origin)
    assert refused(f"http://{own}/") == 404
    assert refused(f"http://{own}/..%2f..%2fetc/passwd") == 404
    assert refused(address, Host="evil.example") == 403


def test_one_viewer_has_the_desk_and_others_look_on(served: LiveServer, hands: PressedKeys) -> None:
    address = served.address.replace("http", "ws") + "stream"
    origin = Origin(served.address.rsplit("/", 2)[0])

    def holder(socket: ClientConnection) -> str:
        while True:
            message = socket.recv(timeout=10)
            told = json.loads(message) if isinstance(message, str) else {}
            if told.get("kind") == "desk":
                return str(told["holder"])

    def send(socket: ClientConnection, *messages: dict[str, str] | list[str]) -> None:
        for message in messages:
            socket.send(json.dumps(message))

    with connect(address, origin=origin) as second:
        with connect(address, origin=origin) as first:
            send(first, {"kind": "key", "key": "e"}, {"kind": "take"})
            before = holder(first), holder(second)
            send(second, {"kind": "take"}, {"kind": "key", "key": "e"}, {"kind": "leave"})
            with connect(address, origin=origin) as late:
                told_late = holder(late)
            send(first, {"kind": "key", "key": "q"}, ["key"], {"kind": "key", "key": "up"})
            first.send("{")
        after = holder(second)
        send(second, {"kind": "take"})
        taken = holder(second)

    assert (before, told_late, after, taken) == (("you", "another"), "another", "", "you")
    assert hands.pressed[:2] == ["up", "let go"]
    assert "e" not in hands.pressed


class NotedActs:
    """Faults that note the acts, and refuse those without a name."""

    catalogue = ({"title": "Bus", "kinds": []},)

    def __init__(self) -> None:
        self.acts: list[object] = []
        self.began: list[dict[str, object]] | None = []

    def act(self, message: Mapping[str, object]) -> str:
        if "fault" not in message:
            return "no name"
        self.acts.append(message["fault"])
        return ""

    def news(self) -> list[dict[str, object]] | None:
        began, self.began = self.began, None
        return began

    def close(self) -> None:
        self.acts.append("closed")


def test_one_viewer_acts_on_faults_and_a_run_without_them_refuses(
    run: Path, served: LiveServer
) -> None:
    faults, act = NotedActs(), {"kind": "fault", "act": "start", "fault": "brake_weak"}

    def next_of(socket: ClientConnection, *kinds: str) -> dict[str, object]:
        while True:
            message = socket.recv(timeout=10)
            told = json.loads(message) if isinstance(message, str) else {}
            if told.get("kind") in kinds:
                return dict(told)

    @contextmanager
    def viewer(server: LiveServer) -> Iterator[ClientConnection]:
        origin = Origin(server.address.rsplit("/", 2)[0])
        with connect(server.address.replace("http", "ws") + "stream", origin=origin) as socket:
            yield socket

    with viewer(served) as socket:
        socket.send(json.dumps(act))
        without = next_of(socket, "refused")["why"]
    allowed = serve_folder(run, faults=faults, host="127.0.0.1", port=0)
    with serving_rig.served(allowed), viewer(allowed) as first, viewer(allowed) as second:
        first.send(json.dumps(act))
        untaken = next_of(first, "refused")["why"]
        for message in ({"kind": "take"}, act, {"kind": "fault", "act": "start"}):
            first.send(json.dumps(message))
        bad = next_of(first, "refused")["why"]
        second.send(json.dumps({"kind": "take"}))
        second.send(json.dumps(act))
        other = next_of(second, "refused")["why"]
        faults.began = [{"kind": "brake_weak", "start_s": 1.5}]
        seen = next_of(second, "faults")["began"], next_of(first, "faults")["began"]
        with viewer(allowed) as late:
            seen_late = next_of(late, "faults")["began"]

    assert "--allow-faults" in str(without)
    assert untaken == other == "Take the faults first; one viewer at a time acts."
    assert bad == "no name"
    assert faults.acts == ["brake_weak", "closed"]
    assert seen[0] == seen[1] == seen_late == [{"kind": "brake_weak", "start_s": 1.5}]


def refused(address: str, **headers: str) -> int:
    with pytest.raises(HTTPError) as refusal:
        urlopen(Request(address, headers=headers))  # noqa: S310
    refusal.value.close()
    return refusal.value.code


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--follow", "embedded:no_such_hub"], "no_such_hub"),
        (["--follow", "can0"], "can0"),
        (["--follow", "embedded:no_such_hub", "--port", "99999"], "no_such_hub"),
    ],
)
def test_a_bus_that_cannot_be_opened_gets_one_line(
    words: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert canlog(["open", *words, "--no-browser"]) == 2

    said = capsys.readouterr().err
    assert said.startswith("canlog: ")
    assert text in said
    assert said.count("\n") == 1


def test_a_folder_that_is_no_run_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from metro_hil.cli.vobc import main as vobc

    (tmp_path / "empty").mkdir()

    assert vobc(["watch", str(tmp_path / "empty"), "--no-browser"]) == 2
    assert vobc(["watch", str(tmp_path / "none"), "--no-browser"]) == 2

    said = capsys.readouterr().err
    assert "no bus.log in this folder" in said
    assert "no folder of a run" in said


def test_a_watched_run_prints_its_page_and_ends_it_without_a_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from metro_hil.cli.vobc import main as vobc

    words = ["run", "--lockstep", "--watch", "--no-plot", "--duration", "0.5"]
    code = vobc([*words, "--out", str(tmp_path / "run")])

    said = capsys.readouterr().out
    assert code == 0
    assert said.startswith("page: http://127.0.0.1:")
    assert (tmp_path / "run" / "page.log").read_text() == ""
    address = said.splitlines()[0].removeprefix("page: ")
    with pytest.raises(URLError, match="refused"):
        urlopen(address)  # noqa: S310


@pytest.mark.parametrize(
    ("text", "doubt"),
    [
        (None, None),
        ("[versions]\nmetro-vobc-bench = '{version}'", None),
        ("[versions]\nmetro-vobc-bench = '0.1.0'", "Version 0.1.0 wrote this run, and this is"),
        ("[versions]\n", "run.toml does not say which version wrote this run."),
        ("[versions", "run.toml cannot be read, so line and train are unknown: Expected"),
    ],
)
def test_a_run_of_another_version_is_shown_with_a_warning(
    tmp_path: Path, text: str | None, doubt: str | None
) -> None:
    if text is not None:
        (tmp_path / "run.toml").write_text(text.format(version=version("metro-vobc-bench")))

    found = doubts_of(tmp_path)

    assert [each.startswith(str(doubt)) for each in found] == [True] * (doubt is not None)
