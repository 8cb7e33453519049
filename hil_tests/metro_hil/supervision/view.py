"""What supervision of a line has received, and its texts."""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Final, NamedTuple

from can_dbc.vobc import Cause, OperatingMode, Supervision
from firmware_py.ports import RadioMessage
from firmware_py.trackdb.areas import AreaMap
from zenoh_config import keys, t2t_keys
from zenoh_config.codec import BENCH_KEY, SafetyKey, unpack
from zenoh_config.messages import SpeedRestriction, TrainStatus
from zenoh_config.t2t import (
    NO_TRAIN,
    Admission,
    AdmissionState,
    AreaAuthority,
    Heartbeat,
    ObjectStatus,
    Phase,
    T2tMessage,
    TrainReport,
)
from zenoh_config.t2t_supervision import LeaseReason, LineState, RemovalAnswer, TrainDecree

NS_PER_S: Final = 1e9
NS_PER_MS: Final = 1e6
SILENT_S: Final = 1.0
SLOW_SILENT_S: Final = 2.0
"""The same for the wayside, its objects and the status of a train, which send less often."""
KMH: Final = 3.6
WHY: Final = {
    LeaseReason.FIRST: "the first that asked",
    LeaseReason.RAN_OUT: "the lease of train {before} had run out",
    LeaseReason.HANDED_OVER: "train {before} handed over",
    LeaseReason.AGAIN: "the train held it before",
}
WAITS: Final = {
    AdmissionState.WAITS: "that train has to be admitted first",
    AdmissionState.COMMITTING: "its arbiters have not committed the roster with the train yet",
    AdmissionState.FULL: "the roster is full",
    AdmissionState.UNPLACED: "its place among the others is not certain yet",
}
"""Reasons why a train is not on a roster yet."""
BLANK: Final = "--"
LATENCY_NS: Final = 60_000_000_000
"""Period whose greatest latency is displayed."""
REPORTS_MAX: Final = 1024
"""Most reports that wait for an authority; one train sends ten a second."""
NO_WAY: Final = "it has no authority to its border yet"


class Command(NamedTuple):
    """Master of an area, according to its last heartbeat."""

    heartbeat: Heartbeat
    heard_ns: int
    since_ns: int
    """Instant of the first heartbeat of this term."""
    before: int
    """Previous master; 0 if none was received."""


class AnswerLatency(NamedTuple):
    """Time from the receipt of a train's report to that of the authority that answers it."""

    at_ns: int
    duration_ms: float


class LineView:
    """The newest message of each kind."""

    def __init__(self, areas: AreaMap, key: SafetyKey = BENCH_KEY) -> None:
        self.areas = areas
        self.commands: dict[int, Command] = {}
        self.reports: dict[int, tuple[TrainReport, int]] = {}
        """The last report of each train to the area that it belongs to, with its instant."""
        self._held: dict[tuple[int, int], tuple[float, int]] = {}
        """End of the authority that a train holds, with the instant of its report, by train and
        area."""
        self.statuses: dict[int, TrainStatus] = {}
        self.objects: dict[int, ObjectStatus] = {}
        self.state: LineState | None = None
        """Last state from the wayside; None if it was not received."""
        self.admissions: dict[tuple[int, int], tuple[Admission, int]] = {}
        """Last reason for waiting from a master and its instant, by train and area."""
        self.removals: dict[int, tuple[RemovalAnswer, int]] = {}
        """Last answer to a removal from a master and its instant, by area."""
        self.latencies: dict[int, deque[AnswerLatency]] = {}
        """Latencies of the last minute, by train; a master sends itself no authority."""
        self.refused = 0
        """Number of messages that were damaged, under another key, or with a wrong sender."""
        self.tokens: Callable[[], Collection[str]] | None = None
        """Liveliness tokens of trains with a session; None: not observed."""
        self._key = key
        self._status_ns: dict[int, int] = {}
        self._object_ns: dict[int, int] = {}
        self._state_ns = 0
        self._reported: dict[tuple[int, int], int] = {}
        """Instant of receipt of the newest reports, by train and sending instant."""

    @property
    def complete(self) -> bool:
        """Whether the wayside and all masters that its arbiters know have been received."""
        if self.state is None:
            return False
        return all(each.area in self.commands for each in self.state.leases)

    @property
    def receives_nothing(self) -> bool:
        return not (self.state or self.commands or self.reports or self.statuses)

    def knows(self, train: int) -> bool:
        """Tell whether the train was received, or named by the wayside or its master."""
        known = {*self.reports, *self.statuses}
        for command in self.commands.values():
            known |= {command.heartbeat.source, command.heartbeat.standby}
        if self.state is not None:
            known |= {each.train for each in self.state.trains}
            known |= {each.train for each in self.state.silent}
        return train in known

    def on_message(self, messages: Iterable[RadioMessage], now_ns: int) -> None:
        for message in messages:
            heard = unpack(message.payload, self._key)
            line = self.areas.name
            if isinstance(heard, TrainStatus) and message.key == keys.status(line, heard.train):
                self.statuses[heard.train], self._status_ns[heard.train] = heard, now_ns
            elif not isinstance(heard, T2tMessage) or message.key != t2t_keys.key_of(line, heard):
                self.refused += 1
            elif isinstance(heard, Heartbeat):
                self._on_heartbeat(heard, now_ns)
            elif isinstance(heard, TrainReport):
                self._on_report(heard, now_ns)
                self._reported[heard.source, heard.stamp_ns] = message.stamp_ns
                if len(self._reported) > REPORTS_MAX:
                    del self._reported[next(iter(self._reported))]
            elif isinstance(heard, AreaAuthority):
                self._on_authority(heard, message.stamp_ns)
            elif isinstance(heard, ObjectStatus):
                self.objects[heard.number], self._object_ns[heard.number] = heard, now_ns
            elif isinstance(heard, LineState):
                self.state, self._state_ns = heard, now_ns
            elif isinstance(heard, Admission):
                self.admissions[heard.destination, heard.area] = heard, now_ns
            elif isinstance(heard, RemovalAnswer):
                self.removals[heard.area] = heard, now_ns

    def _on_heartbeat(self, heartbeat: Heartbeat, now_ns: int) -> None:
        known = self.commands.get(heartbeat.area)
        if known is None:
            self.commands[heartbeat.area] = Command(heartbeat, now_ns, now_ns, NO_TRAIN)
        elif heartbeat.term > known.heartbeat.term:
            before = known.heartbeat.source
            self.commands[heartbeat.area] = Command(heartbeat, now_ns, now_ns, before)
        elif heartbeat.term == known.heartbeat.term:
            self.commands[heartbeat.area] = known._replace(heartbeat=heartbeat, heard_ns=now_ns)

    def _on_report(self, report: TrainReport, now_ns: int) -> None:
        if report.member:
            self._held[report.source, report.area] = (report.held_end_m, now_ns)
        else:
            self._held.pop((report.source, report.area), None)
        known = self.reports.get(report.source)
        owner = self.areas.area_at(report.front_min_m).number
        if known is None or report.area == owner or known[0].area != owner:
            self.reports[report.source] = (report, now_ns)

    def _on_authority(self, authority: AreaAuthority, at_ns: int) -> None:
        reported_ns = self._reported.pop((authority.destination, authority.echo_ns), None)
        if reported_ns is None:
            return
        known = self.latencies.setdefault(authority.destination, deque())
        known.append(AnswerLatency(at_ns, (at_ns - reported_ns) / NS_PER_MS))
        while known[0].at_ns < at_ns - LATENCY_NS:
            known.popleft()

    # The state of the line as text.

    def words(self, now_ns: int) -> list[str]:
        """Return areas, commands for the track, then trains, the foremost first."""
        said = [self._area_words(area.number, now_ns) for area in self.areas.areas]
        trains = sorted(self.reports.values(), key=lambda each: -each[0].front_max_m)
        head = f"train {'front m':>9} {'km/h':>6} {'authority to m':>15} {'term':>5} {'age s':>6}"
        rows = [self._train_words(report, at, now_ns) for report, at in trains]
        return [*said, *self._track_words(now_ns), f"{head}  is", *rows, *self.unseen(now_ns)]

    def unseen(self, now_ns: int) -> list[str]:
        """Return a text for each train that should send reports but does not."""
        missing = {} if self.wayside_silence(now_ns) else self.silent()
        silent = [self._silent_words(*each) for each in missing.items()]
        mute = sorted((self._sessions() or set()) - {*self.reports, *missing})
        return [*silent, *[f"train {each} has a session but sends nothing" for each in mute]]

    def _sessions(self) -> set[int] | None:
        """Return the trains that have a session; None if unknown."""
        if self.tokens is None:
            return None
        found = [t2t_keys.train_of_token(each) for each in self.tokens()]
        return {each for each in found if each is not None}

    def _session_words(self, train: int) -> str:
        """Return whether a non-communicating train still has a session: its program may hang."""
        sessions = self._sessions()
        if sessions is None:
            return ""
        return "; its session exists" if train in sessions else "; it has no session"

    def silent(self) -> dict[int, list[int]]:
        """Return the non-communicating trains on rosters, with the areas."""
        found = dict[int, list[int]]()
        for place in () if self.state is None else self.state.silent:
            found.setdefault(place.train, []).append(place.area)
        return found

    def _silent_words(self, train: int, areas: Sequence[int]) -> str:
        where = " and ".join([str(area) for area in areas])
        words = f"train {train} is silent, on the roster of area {where}: others wait behind it"
        return words + self._session_words(train)

    def reasons(self, now_ns: int) -> list[str]:
        """Return the master of each area, with the reason for its command."""
        said = []
        for area in self.areas.areas:
            words, reason = self._area_words(area.number, now_ns), self.reason(area.number)
            if reason is not None:
                since_s, why = reason
                words += f"; for {since_s:.1f} s, because {why}"
            said.append(words)
        return said

    def reason(self, area: int) -> tuple[float, str] | None:
        """Return how long the master of an area has commanded it, in seconds, and why.

        None if the wayside did not send the grant of the present term.
        """
        command, state = self.commands.get(area), self.state
        if command is None or state is None:
            return None
        for lease in state.leases:
            if (lease.area, lease.granted_term) == (area, command.heartbeat.term):
                why = WHY[lease.reason].format(before=lease.before)
                return (state.stamp_ns - lease.since_ns) / NS_PER_S, why
        return None

    def _area_words(self, area: int, now_ns: int) -> str:
        command = self.commands.get(area)
        if command is None:
            return f"area {area}: no train commands"
        heartbeat = command.heartbeat
        if silence := silence_words(command.heard_ns, now_ns):
            return f"area {area}: train {heartbeat.source}, term {heartbeat.term}, {silence}"
        doing = "commands" if heartbeat.phase is Phase.ISSUING else "takes over"
        standby = f"train {heartbeat.standby}" if heartbeat.standby else "none"
        words = f"area {area}: train {heartbeat.source} {doing}, term {heartbeat.term}"
        words += f", standby {standby}"
        if command.before != NO_TRAIN:
            words += f"; before, train {command.before} did"
        return words

    def _track_words(self, now_ns: int) -> list[str]:
        said = []
        for number in self.objects:
            said.append(f"object {number}: {self.object_words(number, now_ns)}")
        if self.state is None or self.wayside_silence(now_ns):
            return [*sorted(said), self.wayside_words(now_ns)]
        for each in self.state.restrictions:
            said.append(f"at most {each.limit_mps * KMH:g} km/h {stretch_words(each)}")
        return [*said, *[f"closed {stretch_words(each)}" for each in self.state.closed]]

    def object_words(self, number: int, now_ns: int) -> str:
        """Return the state of an object of which a message was received."""
        site = self.objects[number]
        wanted = ", release requested" if site.release_wanted else ""
        silence = silence_words(self._object_ns[number], now_ns, SLOW_SILENT_S)
        return silence or f"{site.state.name.lower()}{wanted}"

    def wayside_words(self, now_ns: int) -> str:
        """Return why no command is possible; empty while the wayside is received."""
        if self.state is None:
            return "the wayside is not received: no command is possible"
        silence = self.wayside_silence(now_ns)
        return f"the wayside has been {silence}: no command is possible" if silence else ""

    def wayside_silence(self, now_ns: int) -> str:
        heard_ns = now_ns if self.state is None else self._state_ns
        return silence_words(heard_ns, now_ns, SLOW_SILENT_S)

    def authority_end(self, report: TrainReport) -> float | None:
        """Return the end of the authority of a train over all areas; None if it holds none.

        An authority of the next area counts while that of this one reaches the border.
        """
        if not report.member:
            return None
        end_m, at_ns = report.held_end_m, self.reports[report.source][1]
        for area in self.areas.areas:
            held = self._held.get((report.source, area.number))
            fresh = held is not None and not silence_words(held[1], at_ns)
            if held is not None and fresh and area.start_m <= end_m < held[0]:
                end_m = held[0]
        return end_m

    def _train_words(self, report: TrainReport, at_ns: int, now_ns: int) -> str:
        end_m = self.authority_end(report)
        end = "–" if end_m is None else f"{end_m:.1f}"
        front = f"{report.front_max_m:.1f}" if report.localised else "lost"
        speed, what = f"{report.speed_mps * KMH:.1f}", self.state_words(report, now_ns)
        if silence := silence_words(at_ns, now_ns):
            what = f"{silence}, last at {front} m{self._session_words(report.source)}"
            end = front = speed = BLANK
        age_s = (now_ns - at_ns) / NS_PER_S
        row = f"{report.source:>5} {front:>9} {speed:>6} {end:>15} {report.term:>5} {age_s:>6.2f}"
        return f"{row}  {what}".rstrip()

    def status(self, train: int, now_ns: int) -> TrainStatus | None:
        """Return the status of a train; None if it is old or was never received."""
        status_ns = self._status_ns.get(train, now_ns)
        return None if silence_words(status_ns, now_ns, SLOW_SILENT_S) else self.statuses.get(train)

    def state_words(self, report: TrainReport, now_ns: int) -> str:
        """Return mode, state of ATP, commands for the train, and what it waits for."""
        said = []
        status = self.status(report.source, now_ns)
        if status is not None:
            # Name the mode as such, because a standby train exists as well.
            said += [f"mode {_name(OperatingMode, status.mode)}", protection_words(status)]
        if report.out_of_service:
            said.append("out of service")
        decree = self.decree(report.source)
        if decree is not None and not self.wayside_silence(now_ns):
            said += [name for name in ("hold", "skip") if getattr(decree, name)]
            said += ["remote emergency brake"] if decree.emergency else []
        said += self._waits(report, now_ns)
        return ", ".join([each for each in said if each])

    def _waits(self, report: TrainReport, now_ns: int) -> list[str]:
        """Return recent reasons for waiting, except for the area that has admitted the train."""
        said = []
        for (train, area), (admission, at_ns) in sorted(self.admissions.items()):
            admitted = report.member and report.area == area
            if train == report.source and not admitted and now_ns - at_ns <= SILENT_S * NS_PER_S:
                said.append(waiting_words(admission))
        return said

    def decree(self, train: int) -> TrainDecree | None:
        trains = () if self.state is None else self.state.trains
        return next((each for each in trains if each.train == train), None)


def silence_words(heard_ns: int, now_ns: int, limit_s: float = SILENT_S) -> str:
    """Return how long nothing was received; empty while that is no silence."""
    age_s = (now_ns - heard_ns) / NS_PER_S
    return f"silent for {age_s:.1f} s" if age_s > limit_s else ""


def protection_words(status: TrainStatus) -> str:
    if status.supervision == Supervision.NOMINAL:
        return ""
    words = _name(Supervision, status.supervision)
    return f"{words}: {_name(Cause, status.cause)}" if status.cause else words


def waiting_words(admission: Admission) -> str:
    state, area, ahead = admission.state, admission.area, admission.waits_for
    if ahead != NO_TRAIN:
        return f"waits for T{ahead} in area {area}: {WAITS[state]}"
    why = NO_WAY if state is AdmissionState.WAITS else WAITS[state]
    return f"waits in area {area}: {why}"


def stretch_words(stretch: SpeedRestriction) -> str:
    return f"from {stretch.start_m:g} to {stretch.end_m:g} m"


def _name(kind: type[OperatingMode] | type[Supervision] | type[Cause], number: int) -> str:
    """Return the name of a value, or the number if this program does not know it."""
    try:
        return kind(number).name.lower().replace("_", " ")
    except ValueError:
        return str(number)
