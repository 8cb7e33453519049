"""The live page: of a run folder that may still grow, or of a bus; and what serves it."""

import difflib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from canlog.damage import LogError
from canlog.database import Bus, load_bus
from canlog.live.feeds import BusFeed, FolderFeed
from canlog.live.server import DeskControl, FaultControl, LiveServer
from canlog.live.stream import VERSION, History
from canlog.reader import read
from canlog.run import BUS_LOG, bus_log_of
from canlog.views.facts import verdict_names
from canlog.views.page_data import page_data
from canlog.views.page_text import html_page, page_text
from canlog.views.place import LineFacts, line_of
from canlog.views.traces import default_words, trace_names
from firmware_py.buses import BusError, open_can
from firmware_py.clock.clock import WallClock

PANELS: Final = (
    ("VOBC_MOTION.speed_mps", "VOBC_MOTION.ceiling_mps", "VOBC_MOTION.emergency_mps"),
    ("VOBC_STATUS.supervision", "VOBC_STATUS.ato_phase"),
    ("BRAKE_STATUS.applied_decel_mps2", "BRAKE_CMD.service_decel_mps2"),
)
"""Panels of this project's bus; names that the bus lacks are left out."""
CURVES: Final = (
    ("emergency", "VOBC_MOTION.emergency_mps"),
    ("ceiling", "VOBC_MOTION.ceiling_mps"),
    ("estimate", "VOBC_MOTION.speed_mps"),
)
PLACE: Final = "VOBC_POSITION.front_m"


def serve_folder(
    folder: Path,
    *,
    hands: DeskControl | None = None,
    faults: FaultControl | None = None,
    host: str,
    port: int,
) -> LiveServer:
    """Return the server of a run: live while it goes on, then its report.

    Args:
        hands: the desk of the train, if viewers may use it.
        faults: the faults of the run, if viewers may start and stop them.

    Raises:
        LogError: if the folder is no run, or the port is taken.
    """
    if not folder.is_dir():
        raise LogError(f"{folder}: no folder of a run")
    if not (folder / BUS_LOG).is_file() and not (folder / "run.toml").is_file():
        bus_log_of(folder)
    bus = load_bus()
    history, title = History(bus), folder.resolve().name
    head = live_head(bus, title, line_of(folder)) | {"messages": history.heads}
    if hands is not None:
        head["desk"] = hands.keys
    if faults is not None:
        head["faults"] = faults.catalogue
    report = _Report(folder, title)
    feed = FolderFeed(folder, bus)

    def page() -> str:
        return report.text(history.remark) if history.ended else html_page(head)

    now_ns = WallClock().epoch_ns
    return LiveServer(
        feed, history, page, now_ns=now_ns, hands=hands, faults=faults, host=host, port=port
    )


def serve_bus(
    spec: str,
    bus: Bus,
    words: Sequence[str] = (),
    *,
    events_on_bus: bool,
    host: str,
    port: int,
) -> LiveServer:
    """Return the server of a live bus.

    Args:
        words: panels; names of signals, joined by commas.
        events_on_bus: the bus has this project's event frames.

    Raises:
        LogError: if the bus cannot be opened, or the port is taken.
    """
    clock = WallClock()
    try:
        can = open_can(spec, clock=clock, node="canlog")
    except BusError as error:
        raise LogError(str(error)) from error
    feed = BusFeed(can, spec, clock.epoch_offset_ns)
    history = History(bus)
    head = live_head(bus, spec, LineFacts(), words)
    text = html_page(head | {"messages": history.heads, "eventsOnBus": events_on_bus})
    return LiveServer(feed, history, lambda: text, now_ns=clock.epoch_ns, host=host, port=port)


class _Report:
    """The page of the whole run, made when the first viewer asks for it after the end."""

    def __init__(self, folder: Path, title: str) -> None:
        self._folder, self._title = folder, title
        self._text: str | None = None

    def text(self, remark: str) -> str:
        """Return the page with a remark on top. Raises LogError if the log cannot be read."""
        if self._text is None:
            log = read(self._folder)
            words = default_words(log) if trace_names(log) else []
            data = page_data(log, self._title, words, with_frames=True)
            data.head["warnings"] = [*([remark] if remark else []), *data.head["warnings"]]
            self._text = page_text(data)
        return self._text


def live_head(bus: Bus, title: str, line: LineFacts, words: Sequence[str] = ()) -> dict[str, Any]:
    """Return what the live page knows before the stream begins.

    Raises:
        LogError: for a word that names no signal of the bus.
    """
    known = {f"{spec.name}.{each.name}" for spec in bus.by_key.values() for each in spec.signals}
    asked = [word.split(",") for word in words]
    for name in (name for panel in asked for name in panel):
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise LogError(f"{bus.name}: no signal {name}{hint}")
    panels = asked or [[name for name in panel if name in known] for panel in PANELS]
    journey = None
    if PLACE in known:
        curves = [{"role": role, "name": name} for role, name in CURVES if name in known]
        journey = {"curves": curves, "place": PLACE, "authority": False, **line.head()}
    return {
        "title": title,
        "live": VERSION,
        "zero": "0",
        "date": "",
        "span": [0, 1_000_000_000],
        "panels": [panel for panel in panels if panel],
        "messages": [],
        "events": [],
        "warnings": [],
        "inOrder": True,
        "stats": {"messages": [], "buses": [], "absent": [], "not_judged": []},
        "verdicts": verdict_names(),
        "remote": False,
        "frames": {"count": 0, "channels": []},
        "cycles": False,
        "extras": [],
        "journey": journey,
        "block": {},
    }
