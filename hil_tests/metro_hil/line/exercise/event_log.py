"""The events of a line, from its radio messages and the true positions of trains.

Pure functions.
"""

import itertools
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from can_dbc.vobc import Cause, Supervision
from firmware_py.ports import RadioMessage
from firmware_py.trackdb import LineMap
from firmware_py.trackdb.areas import Area, AreaMap
from plant_emulator.wayside.detection import LAYOUT, Place, subscription
from zenoh_config import keys, t2t_keys
from zenoh_config.codec import BENCH_KEY, SafetyKey, unpack
from zenoh_config.messages import TrainStatus
from zenoh_config.t2t import AreaAuthority, Heartbeat, T2tMessage, TrainReport

NS_PER_S: Final = 1e9
NS_PER_MS: Final = 1e6
STOPPED_M: Final = 2.0
"""Distance to a stopping point within which a train that stands has stopped there."""
YOUNG_NS: Final = 1_000_000_000
MOVED_M: Final = 0.01
REACHES: Final = 32
OLD: Final = Cause.AUTHORITY_OLD.name.lower().replace("_", " ")
"""Cause that a wayside fault explains: without arbiters authorities grow old, and trains brake."""
DRIVING: Final = (Supervision.NOMINAL, Supervision.WARNING, Supervision.SERVICE)
"""States of supervision that a train can reach only with an authority."""


class StopEvent(NamedTuple):
    station: str
    error_m: float


class EmergencyBrakeEvent(NamedTuple):
    """An emergency brake that ATP applied."""

    at_ns: int
    cause: str
    commanded: bool
    """Whether the train held a fresh authority."""
    excused: bool
    """Whether a fault of the train or of the line explains the brake, or no train had commanded it
    yet."""


class Given(NamedTuple):
    """An authority as received, or as a master reports to hold it itself."""

    at_ns: int
    term: int
    end_m: float
    echo_ns: int
    said_ns: int
    """Instant at which the master sent it, or the train reported it, by their clocks."""


@dataclass(slots=True)
class TrainEvents:
    place: Place | None = None
    speed_mps: float | None = None
    """True speed, from the true positions; the train's own reports end with its controller."""
    given: dict[int, Given] = field(default_factory=dict)
    """The newest authority, by area."""
    reaches: deque[Given] = field(default_factory=lambda: deque(maxlen=REACHES))
    """The latest authorities that limited the train, for positions that arrive late."""
    supervision: int = Supervision.NO_AUTHORITY
    stops: list[StopEvent] = field(default_factory=list)
    emergencies: list[EmergencyBrakeEvent] = field(default_factory=list)
    service_brakes: int = 0
    least_gap_m: float = float("inf")
    """Least distance from the end of its authority to the true rear of the train ahead."""
    oldest_ms: float = 0.0
    """Greatest age of its authority until a newer one came."""
    latencies_ms: list[float] = field(default_factory=list)
    """Time from each report to the authority that answers it."""
    struck: bool = False
    """Whether a fault struck the train; then its behaviour is not a failure of any train."""
    standing: bool = False
    drove: bool = False
    """Whether frames on its bus showed that ATP let it move, so that it had an authority."""


class Takeover(NamedTuple):
    """A takeover that must follow because the run struck a master."""

    area: int
    train: int
    """The train that was struck."""
    term: int


class TermEvent(NamedTuple):
    at_ns: int
    """Instant of the term's first heartbeat."""
    number: int
    train: int
    """The train that commands."""


@dataclass(slots=True)
class AreaEvents:
    heartbeat: Heartbeat
    heard_ns: int
    waiting: set[int] = field(default_factory=set)
    """Trains that have no authority of this term yet."""
    since_ns: int = 0
    """Instant of the last heartbeat of the previous term."""
    terms: list[TermEvent] = field(default_factory=list)


class LineEvents:
    """Takes all events in order; passes to `say` what a person should know at once."""

    def __init__(
        self,
        line: LineMap,
        areas: AreaMap,
        say: Callable[[int, str], None],
        key: SafetyKey = BENCH_KEY,
        *,
        own_clocks: bool = False,
    ) -> None:
        """Args:
        own_clocks: each train has a clock of its own; when that began is estimated from the
            reports. Otherwise all use the clock of this machine.
        """
        self.trains: dict[int, TrainEvents] = {}
        self.areas: dict[int, AreaEvents] = {}
        self.collisions: list[str] = []
        self.excused: set[str] = set()
        """Causes of emergency brakes that a fault of the line explains from now on."""
        self.refused = 0
        self.newest_ns = 0
        """Sending instant of the newest message, by the clock of its sender."""
        self.ordered: list[Takeover] = []
        self.missed_strikes: list[str] = []
        """Faults that were due while no train commanded."""
        self._own_clocks = own_clocks
        self._began_ns: dict[int, int] = {}
        """Instant of this machine's clock at which the clock of each train began."""
        self._line, self._map, self._say, self._key = line, areas, say, key
        self._rails = subscription(areas.name).removesuffix("*")

    def train(self, number: int) -> TrainEvents:
        return self.trains.setdefault(number, TrainEvents())

    # Inputs.

    def on_message(self, messages: Iterable[RadioMessage]) -> None:
        for message in messages:
            if message.key.startswith(self._rails):
                number = message.key.removeprefix(self._rails)
                if len(message.payload) == LAYOUT.size and number.isdecimal():
                    place = Place(*LAYOUT.unpack(message.payload))
                    self._note_sent(place.stamp_ns, message.stamp_ns)
                    self.stands(int(number), place)
                else:
                    self.refused += 1
                continue
            heard = unpack(message.payload, self._key)
            name = self._map.name
            if isinstance(heard, TrainStatus) and message.key == keys.status(name, heard.train):
                # Each train's bus reports its protection, even while no radio works.
                continue
            if isinstance(heard, T2tMessage) and message.key == t2t_keys.key_of(name, heard):
                self._note_sent(heard.stamp_ns, message.stamp_ns)
                self._on_message(heard, message.stamp_ns)
            elif not message.key.startswith(f"m/{keys.line_chunk(name)}/w/0/or/"):
                self.refused += 1

    def stands(self, number: int, place: Place) -> None:
        """Take the true position of a train."""
        train = self.train(number)
        before, train.place = train.place, place
        if before is not None and place.stamp_ns > before.stamp_ns:
            past_s = (place.stamp_ns - before.stamp_ns) / NS_PER_S
            train.speed_mps = (place.front_m - before.front_m) / past_s
        standing = before is not None and abs(place.front_m - before.front_m) < MOVED_M
        if standing and not train.standing:
            self._stopped(train, place.front_m)
        train.standing = standing
        for behind, ahead in self._neighbours():
            if number in (behind, ahead):
                self._collide(behind, ahead)
            if number == ahead:
                self._keep_apart(self.trains[behind], before, place)

    def tells(self, number: int, supervision: int, cause: int, now_ns: int) -> None:
        """Take the state of a train's ATP; the verdict decides whether it is correct."""
        train = self.train(number)
        train.drove |= supervision in DRIVING
        before, train.supervision = train.supervision, supervision
        if supervision == before:
            return
        if supervision == Supervision.SERVICE and not train.struck:
            train.service_brakes += 1
        if supervision == Supervision.EMERGENCY:
            words = cause_words(cause)
            commanded = self._is_commanded(train, now_ns)
            excused = train.struck or not train.given or words in self.excused
            train.emergencies.append(EmergencyBrakeEvent(now_ns, words, commanded, excused))
            self._say(now_ns, f"train {number} applies its emergency brake: {words}")

    def strikes(self, number: int) -> None:
        self.train(number).struck = True

    def leaves(self, number: int) -> None:
        """A train takes no part in this line any more; its clock begins again if it returns."""
        train = self.train(number)
        train.place = None
        train.given.clear()
        train.reaches.clear()
        self._began_ns.pop(number, None)

    def has_others(self, area: int, number: int) -> bool:
        """Whether a train other than this one is in an area."""
        return any(self._is_here(each, area) for n, each in self.trains.items() if n != number)

    def orders_takeover(self, area: int, number: int) -> None:
        """The master of an area is struck, so another train there must take over."""
        if self.has_others(area, number):
            self.ordered.append(Takeover(area, number, self._term(area)))

    def unseen_takeovers(self) -> list[Takeover]:
        """Return the takeovers that were due and not followed by a higher term."""
        return [each for each in self.ordered if self._term(each.area) <= each.term]

    def _term(self, area: int) -> int:
        """Return the highest term received in the area."""
        return self.areas[area].heartbeat.term if area in self.areas else 0

    def _note_sent(self, sent_ns: int, taken_ns: int) -> None:
        """Note the sending instant; no message is sent later than it is received."""
        self.newest_ns = max(self.newest_ns, min(sent_ns, taken_ns))

    # Evaluation.

    def _on_message(self, message: T2tMessage, now_ns: int) -> None:
        if isinstance(message, Heartbeat):
            self._on_heartbeat(message, now_ns)
        elif isinstance(message, AreaAuthority):
            self._on_authority(message, now_ns)
        elif isinstance(message, TrainReport):
            self._on_report(message, now_ns)

    def _on_report(self, report: TrainReport, now_ns: int) -> None:
        train = self.train(report.source)
        if self._own_clocks:
            began_ns = now_ns - report.stamp_ns
            # The fastest report tells best.
            self._began_ns[report.source] = min(
                began_ns, self._began_ns.get(report.source, began_ns)
            )
        sent_ns = report.stamp_ns + self._began_ns.get(report.source, 0)
        story = self.areas.get(report.area)
        if report.member and story is not None and story.heartbeat.source == report.source:
            # A master's authority for itself is not sent by radio.
            given = Given(
                *(now_ns, report.held_term, report.held_end_m),
                echo_ns=sent_ns,
                said_ns=sent_ns,
            )
            before = train.given.get(report.area)
            counts = not train.struck and self._is_here(train, report.area)
            if before is not None and before.term < given.term and counts:
                # A train that takes over waited until it could give itself an authority.
                age_ms = (sent_ns - before.echo_ns) / NS_PER_MS
                train.oldest_ms = max(train.oldest_ms, age_ms)
            train.given[report.area] = given

    def _on_heartbeat(self, heartbeat: Heartbeat, now_ns: int) -> None:
        area, who = heartbeat.area, heartbeat.source
        known = self.areas.get(area)
        if known is None:
            first = TermEvent(now_ns, heartbeat.term, who)
            self.areas[area] = AreaEvents(heartbeat, now_ns, since_ns=now_ns, terms=[first])
            self._say(now_ns, f"area {area}: train {who} commands, term {heartbeat.term}")
            return
        if heartbeat.term < known.heartbeat.term:
            return
        if heartbeat.term > known.heartbeat.term:
            before, quiet_s = known.heartbeat.source, (now_ns - known.heard_ns) / NS_PER_S
            known.waiting = {
                number
                for number, train in self.trains.items()
                if number not in (who, before) and _holds(train, area, now_ns)
            }
            known.since_ns = known.heard_ns
            known.terms.append(TermEvent(now_ns, heartbeat.term, who))
            self._say(
                now_ns,
                f"area {area}: train {who} commands, term {heartbeat.term}; train {before} sent "
                f"its last heartbeat {quiet_s:.2f} s before",
            )
        known.heartbeat, known.heard_ns = heartbeat, now_ns

    def _on_authority(self, authority: AreaAuthority, now_ns: int) -> None:
        train = self.train(authority.destination)
        before = train.given.get(authority.area)
        if before is not None and authority.term < before.term:
            return
        echo_ns = authority.echo_ns + self._began_ns.get(authority.destination, 0)
        train.latencies_ms.append((now_ns - echo_ns) / NS_PER_MS)
        if before is not None and self._is_here(train, authority.area) and not train.struck:
            age_ms = (now_ns - before.echo_ns) / NS_PER_MS
            train.oldest_ms = max(train.oldest_ms, age_ms)
        given = Given(
            *(now_ns, authority.term, authority.end_m, echo_ns),
            said_ns=authority.stamp_ns + self._began_ns.get(authority.source, 0),
        )
        train.given[authority.area] = given
        story = self.areas.get(authority.area)
        if story is not None and authority.term == story.heartbeat.term and story.waiting:
            story.waiting.discard(authority.destination)
            if not story.waiting:
                after_s = (now_ns - story.since_ns) / NS_PER_S
                self._say(
                    now_ns,
                    f"area {authority.area}: every train has an authority of term "
                    f"{authority.term}, {after_s:.2f} s after the last heartbeat before it",
                )

    def _is_here(self, train: TrainEvents, area: int) -> bool:
        here = None if train.place is None else self._map.area_at(train.place.front_m)
        return here is not None and here.number == area

    def _is_commanded(self, train: TrainEvents, now_ns: int) -> bool:
        return any(_holds(train, area, now_ns) for area in train.given)

    def _stopped(self, train: TrainEvents, front_m: float) -> None:
        for station in self._line.stations:
            stop = StopEvent(station.name, front_m - station.stop_m)
            if abs(stop.error_m) > STOPPED_M:
                continue
            if train.stops and train.stops[-1].station == station.name:
                train.stops[-1] = stop
            else:
                train.stops.append(stop)

    def _neighbours(self) -> Iterable[tuple[int, int]]:
        """Return each train with the one ahead of it."""
        placed = sorted(
            [(t.place.front_m, n) for n, t in self.trains.items() if t.place is not None]
        )
        return [(behind, ahead) for (_, behind), (_, ahead) in itertools.pairwise(placed)]

    def _collide(self, behind: int, ahead: int) -> None:
        train, rear = self.trains[behind].place, self.trains[ahead].place
        assert train is not None
        assert rear is not None
        if train.front_m > rear.rear_m:
            words = f"train {behind} stands in train {ahead}"
            if words not in self.collisions:
                self.collisions.append(words)

    def _keep_apart(self, train: TrainEvents, before: Place | None, ahead: Place) -> None:
        """Measure the distance from the end of an authority to the true rear of the train ahead.

        The rear counts where it was when the authority was sent, or now if that is later. A
        position that was delayed is older than that, and its train has moved on since.
        """
        newest = self._reach(train)
        if newest is None:
            train.reaches.clear()
        elif not train.reaches or newest != train.reaches[-1]:
            train.reaches.append(newest)
        older = [each for each in train.reaches if each.said_ns <= ahead.stamp_ns]
        if not older:
            return
        reach = older[-1]
        rear_m = ahead.rear_m
        if before is not None and before.stamp_ns < reach.said_ns:
            share = (reach.said_ns - before.stamp_ns) / (ahead.stamp_ns - before.stamp_ns)
            rear_m = before.rear_m + share * (ahead.rear_m - before.rear_m)
        train.least_gap_m = min(train.least_gap_m, rear_m - reach.end_m)

    def _reach(self, train: TrainEvents) -> Given | None:
        """Return the authority that limits the train, after all that continue it."""
        assert train.place is not None
        area: Area | None = self._map.area_at(train.place.front_m)
        last = None
        while area is not None and (given := train.given.get(area.number)) is not None:
            last = given
            if given.end_m < area.end_m:
                break
            area = self._map.following(area.number)
        return last


def cause_words(cause: int) -> str:
    """Return the cause as text; only a controller that starts or ends brakes without a cause."""
    return Cause(cause).name.lower().replace("_", " ") if cause else "its controller ends"


def _holds(train: TrainEvents, area: int, now_ns: int) -> bool:
    given = train.given.get(area)
    return given is not None and now_ns - given.echo_ns < YOUNG_NS
