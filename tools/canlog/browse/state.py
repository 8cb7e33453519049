"""State of the terminal browser, and the effect of each key on it."""

import enum
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from canlog.browse.lanes import ERRORS, Lane, Lanes
from canlog.frames import KEY_EXTENDED
from canlog.table import KEY_MASK
from canlog.views.happenings import Happening

NS_PER_S: Final = 1_000_000_000
WINDOWS_S: Final = (1.0, 2.0, 5.0, 10.0, 30.0, 60.0, 300.0, 1800.0)
SPEEDS: Final = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 50.0, 100.0)
PAGE: Final = 10


class Focus(enum.Enum):
    MESSAGES = "messages"
    SIGNALS = "signals"


class ListOrder(enum.Enum):
    """Order of the message list."""

    IDENTIFIER = "id"
    NAME = "name"
    RATE = "rate"
    AGE = "age"


@dataclass(slots=True)
class BrowserState:
    """Everything that keys can change."""

    title: str
    lanes: Lanes
    zero_ns: int
    at_ns: int
    """The screen shows the bus as it was known at this instant."""
    live: bool = False
    happenings: Sequence[Happening] = ()
    running: bool = False
    """Whether a log plays, or whether a live bus is followed."""
    speed: int = SPEEDS.index(1.0)
    window: int = WINDOWS_S.index(10.0)
    """Index into WINDOWS_S: time span of the small plots."""
    selected: int | None = None
    """Key of the selected message."""
    signal: int = 0
    """Index of the selected signal in that message."""
    focus: Focus = Focus.MESSAGES
    order: ListOrder = ListOrder.IDENTIFIER
    search: str = ""
    typing: bool = False
    plot: bool = False
    """Whether a large plot of the signal is shown."""
    help: bool = False
    bookmarks: list[int] = field(default_factory=list)
    note: str = ""
    done: bool = False

    @property
    def window_ns(self) -> int:
        return round(WINDOWS_S[self.window] * NS_PER_S)

    @property
    def lane(self) -> Lane | None:
        """The selected message."""
        return self.lanes.lanes.get(self.selected) if self.selected is not None else None

    def seconds(self, at_ns: int) -> float:
        return (at_ns - self.zero_ns) / NS_PER_S

    def go(self, at_ns: int) -> None:
        self.at_ns = min(max(at_ns, self.lanes.start_ns), self.lanes.end_ns)
        if self.live:
            self.running = False


def shown(state: BrowserState) -> list[Lane]:
    """Return the messages that match the search, in the chosen order."""
    words = state.search.lower().split()
    found = [lane for lane in state.lanes.sorted() if all(_has(lane, word) for word in words)]
    at_ns = state.at_ns
    if state.order is ListOrder.NAME:
        found.sort(key=lambda lane: lane.name)
    elif state.order is ListOrder.RATE:
        found.sort(key=lambda lane: -lane.rate_hz(at_ns))
    elif state.order is ListOrder.AGE:
        found.sort(key=lambda lane: _age_ns(lane, at_ns))
    return found


def _has(lane: Lane, word: str) -> bool:
    """Whether the word is in the name, is the identifier, or is in the name of a signal."""
    if word in lane.name.lower() or word.removeprefix("0x") == id_text(lane.key).lower():
        return True
    return lane.spec is not None and any(word in each.name.lower() for each in lane.spec.signals)


def _age_ns(lane: Lane, at_ns: int) -> int:
    row = lane.row_at(at_ns)
    return at_ns - int(lane.at_ns[row]) if row >= 0 else 1 << 62


def id_text(key: int) -> str:
    if key == ERRORS:
        return ""
    key &= KEY_MASK
    return f"{key & ~KEY_EXTENDED:08X}" if key & KEY_EXTENDED else f"{key:03X}"


def advance(state: BrowserState, elapsed_ns: int) -> None:
    """Let time pass: a log plays on, and a live bus shows the present."""
    if not state.running:
        return
    if state.live:
        state.at_ns = state.lanes.end_ns
        return
    state.at_ns += round(elapsed_ns * SPEEDS[state.speed])
    if state.at_ns >= state.lanes.end_ns:
        state.at_ns, state.running, state.note = state.lanes.end_ns, False, "end of the log"


def press(state: BrowserState, key: str) -> None:
    """Apply one key by its name: a character, or `up`, `down`, `enter`, `escape` and so on."""
    state.note = ""
    if state.typing:
        _type(state, key)
        return
    if state.help:
        state.help = False
        return
    action = ACTIONS.get(key)
    if action is not None:
        action[1](state)


def _type(state: BrowserState, key: str) -> None:
    if key == "enter":
        state.typing = False
    elif key == "escape":
        state.typing, state.search = False, ""
    elif key == "backspace":
        state.search = state.search[:-1]
    elif len(key) == 1 and key.isprintable():
        state.search += key
    lanes = shown(state)
    if lanes and state.lane not in lanes:
        state.selected, state.signal = lanes[0].key, 0


def _move(by: int) -> Callable[[BrowserState], None]:
    def move(state: BrowserState) -> None:
        if state.focus is Focus.SIGNALS:
            count = len(state.lane.spec.signals) if state.lane and state.lane.spec else 0
            state.signal = min(max(state.signal + by, 0), max(0, count - 1))
            return
        keys = [lane.key for lane in shown(state)]
        if not keys:
            return
        at = keys.index(state.selected) + by if state.selected in keys else 0
        state.selected, state.signal = keys[min(max(at, 0), len(keys) - 1)], 0

    return move


def _step(by: int) -> Callable[[BrowserState], None]:
    """Go to the next or the previous frame of the selected message."""

    def step(state: BrowserState) -> None:
        lane = state.lane
        if lane is None or not len(lane):
            return
        row = lane.row_at(state.at_ns)
        on_it = row >= 0 and int(lane.at_ns[row]) == state.at_ns
        row = row + by if by > 0 or on_it else row
        if 0 <= row < len(lane):
            state.go(int(lane.at_ns[row]))
        else:
            state.note = f"no frame of {lane.name} {'after' if by > 0 else 'before'} this"

    return step


def _jump(by_s: float) -> Callable[[BrowserState], None]:
    return lambda state: state.go(state.at_ns + round(by_s * NS_PER_S))


def _event(by: int) -> Callable[[BrowserState], None]:
    def event(state: BrowserState) -> None:
        found = [each for each in state.happenings if (each.at_ns - state.at_ns) * by > 0]
        if not found:
            state.note = "no event there"
            return
        each = found[0] if by > 0 else found[-1]
        state.go(each.at_ns)
        state.note = f"{each.kind.lower().replace('_', ' ')}: {each.words}"

    return event


def _bookmark(state: BrowserState) -> None:
    if state.at_ns in state.bookmarks:
        state.bookmarks.remove(state.at_ns)
        state.note = "bookmark removed"
    else:
        state.bookmarks = sorted([*state.bookmarks, state.at_ns])
        state.note = f"bookmark {len(state.bookmarks)} at {state.seconds(state.at_ns):.6f} s"


def _next_bookmark(state: BrowserState) -> None:
    if not state.bookmarks:
        state.note = "no bookmarks; b makes one"
        return
    later = [each for each in state.bookmarks if each > state.at_ns]
    state.go(later[0] if later else state.bookmarks[0])


def _run(state: BrowserState) -> None:
    if not state.live and state.at_ns >= state.lanes.end_ns:
        state.at_ns = state.lanes.start_ns
    state.running = not state.running


def _cycle_order(state: BrowserState) -> None:
    orders = list(ListOrder)
    state.order = orders[(orders.index(state.order) + 1) % len(orders)]


def _focus(state: BrowserState) -> None:
    state.focus = Focus.SIGNALS if state.focus is Focus.MESSAGES else Focus.MESSAGES


def _choose(name: str, by: int, count: int) -> Callable[[BrowserState], None]:
    def choose(state: BrowserState) -> None:
        setattr(state, name, min(max(getattr(state, name) + by, 0), count - 1))

    return choose


def _set(name: str, value: bool | None = None) -> Callable[[BrowserState], None]:
    def change(state: BrowserState) -> None:
        setattr(state, name, not getattr(state, name) if value is None else value)

    return change


def _escape(state: BrowserState) -> None:
    state.search, state.plot = "", False


ACTIONS: Final[Mapping[str, tuple[str, Callable[[BrowserState], None]]]] = {
    "up": ("message or signal before", _move(-1)),
    "down": ("message or signal after", _move(1)),
    "pageup": ("", _move(-PAGE)),
    "pagedown": ("", _move(PAGE)),
    "tab": ("to signals and back", _focus),
    "enter": ("large plot of the signal", _set("plot")),
    "/": ("search messages and signals", _set("typing", True)),
    "escape": ("end search or plot", _escape),
    "space": ("play or stop; freeze a live bus", _run),
    "left": ("frame of the message before", _step(-1)),
    "right": ("frame after", _step(1)),
    ",": ("a second back", _jump(-1.0)),
    ".": ("a second on", _jump(1.0)),
    "<": ("ten seconds back", _jump(-10.0)),
    ">": ("ten seconds on", _jump(10.0)),
    "home": ("start", lambda state: state.go(state.lanes.start_ns)),
    "end": ("end", lambda state: state.go(state.lanes.end_ns)),
    "e": ("next event", _event(1)),
    "E": ("event before", _event(-1)),
    "b": ("bookmark here, or remove it", _bookmark),
    "'": ("next bookmark", _next_bookmark),
    "+": ("play faster", _choose("speed", 1, len(SPEEDS))),
    "-": ("play slower", _choose("speed", -1, len(SPEEDS))),
    "]": ("longer plots", _choose("window", 1, len(WINDOWS_S))),
    "[": ("shorter plots", _choose("window", -1, len(WINDOWS_S))),
    "s": ("order of the list", _cycle_order),
    "?": ("this list", _set("help", True)),
    "q": ("end", _set("done", True)),
}
"""Help text and action of each key."""
