"""A supervision console: it repeats a command until it is carried out, and reports the outcome."""

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from can_dbc.vobc import Supervision
from firmware_py.clock.clock import WallClock
from firmware_py.ports import RadioPort
from metro_hil.model.run_options import EXIT_ENVIRONMENT, EXIT_OK
from metro_hil.supervision.nearby_trains import is_near
from metro_hil.supervision.view import (
    KMH,
    SILENT_S,
    Command,
    LineView,
    protection_words,
    stretch_words,
)
from zenoh_config import t2t_keys
from zenoh_config.codec import BENCH_KEY, SafetyKey, pack
from zenoh_config.messages import WAYSIDE, SpeedRestriction
from zenoh_config.t2t import NO_TRAIN, SUPERVISION, LineOrder, OrderKind, T2tMessage
from zenoh_config.t2t_supervision import (
    Decree,
    DecreeAnswer,
    DecreeKind,
    LineState,
    Removal,
    RemovalAnswer,
    RemovalState,
)

NS_PER_S: Final = 1_000_000_000
NS_PER_US: Final = 1000
BEAT_NS: Final = 50_000_000
ORDER_S: Final = 3.0
REFUSALS: Final = {
    DecreeAnswer.UNKNOWN_TRAIN: "no such train sends its status to the wayside",
    DecreeAnswer.NO_STRETCH: "no such stretch on {line}, which reaches from {start:g} to {end:g} m",
    DecreeAnswer.FULL: "no room for another one; take one back first",
    DecreeAnswer.NOT_THERE: "no such command is in force",
    DecreeAnswer.NOT_STORED: "the wayside cannot store the command, so it is not in force",
    DecreeAnswer.TOO_OLD: "the command arrived too late; the radio is too slow",
}
NARROWING: Final = (DecreeKind.RESTRICT, DecreeKind.CLOSE)
"""Commands that may take effect too close ahead of a train."""
REPORTS_S: Final = 0.3
"""Time within which every train in an area reports, even if a message is lost."""
NO_STATION: Final = "no station is ahead of the train, or the train is not localised"
KEPT: Final = {
    RemovalState.COMMITTING: "its arbiters have not committed the roster without it",
    RemovalState.HEARD: "it is received, or was until just now; only a silent train can be removed",
    RemovalState.AXLES: "axles are counted where it may be that no train there accounts for",
    RemovalState.TOO_OLD: "the command arrived too late; the radio is too slow",
}


class SupervisionConsole:
    def __init__(
        self,
        clock: WallClock,
        view: LineView,
        port: RadioPort,
        key: SafetyKey = BENCH_KEY,
        database: int | None = None,
    ) -> None:
        """`database` is the version of the track database by which commands give places."""
        self._clock, self._view, self._port, self._key = clock, view, port, key
        self._database = database
        epoch_ns = clock.epoch_ns()
        self._boot = epoch_ns // NS_PER_S
        # The sequence starts at the microsecond, so that two consoles of one second do not collide.
        self._sequence = epoch_ns % NS_PER_S // NS_PER_US

    def listen(self, duration_s: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Receive for a while, or until the condition holds; return whether it did."""
        end_ns = self._clock.now_ns() + round(duration_s * NS_PER_S)
        while self._clock.now_ns() < end_ns:
            self._clock.wait_until(self._clock.now_ns() + BEAT_NS)
            now_ns = self._clock.now_ns()
            self._view.on_message(self._port.receive(now_ns), now_ns)
            if until():
                return True
        return False

    def say(self, lines: Sequence[str], *, over: bool = False) -> None:
        clear = "\033[2J\033[H" if over and sys.stdout.isatty() else ""
        print(clear + "\n".join(lines), flush=True)

    # Commands to masters and trains.

    def switch(self, area: int, to: int) -> int:
        """Request another master until it commands, or the time is over."""
        if area not in self._view.commands:
            return self.fail_without_command(f"area {area}")

        def switched() -> bool:
            now = self._view.commands[area]
            if now.heartbeat.source == to:
                return True
            heartbeat = now.heartbeat
            self._order(OrderKind.SWITCH_MASTER, to, heartbeat.source, area, heartbeat.term)
            return False

        if self.listen(ORDER_S, switched):
            print(f"area {area}: train {to} commands")
            return EXIT_OK
        return _failed(f"train {to} did not take over area {area}; does it run?")

    def retire(self, train: int, *, end: bool) -> int:
        """Send every master the command until the train commands no area.

        A train that returns to service gets its command even if no train commands: perhaps none is
        left that could.
        """
        view, asked_ns = self._view, self._clock.now_ns()
        if not (view.commands or (end and train in view.reports)):
            return self.fail_without_command()
        if not self.listen(ORDER_S, lambda: view.knows(train)):
            return self._unknown(train)

        def says_so() -> bool:
            report, at_ns = view.reports.get(train, (None, 0))
            return report is not None and at_ns >= asked_ns and report.out_of_service is not end

        def done() -> bool:
            self._serve(train, OrderKind.IN_SERVICE if end else OrderKind.OUT_OF_SERVICE)
            return says_so() and (end or not self._duties(train))

        if self.listen(ORDER_S, done):
            now = "is in service again" if end else "commands no area and is standby for none"
            print(f"train {train} {now}")
            return EXIT_OK
        if not says_so():
            return _failed(
                f"train {train} does not report that it is {'in' if end else 'out of'} service"
            )
        duties = " and ".join(self._duties(train))
        print(f"train {train} is out of service; until another train takes over, it still {duties}")
        return EXIT_OK

    def _serve(self, train: int, kind: OrderKind) -> None:
        terms: dict[int, int] = {}
        if train in self._view.reports:
            report, _ = self._view.reports[train]
            terms[report.area] = report.term
        for area, command in self._view.commands.items():
            terms[area] = command.heartbeat.term
            self._order(kind, train, command.heartbeat.source, area, terms[area])
        # The train itself must know, because it reports this to every later master.
        for area, term in terms.items():
            self._order(kind, train, train, area, term)

    def _duties(self, train: int) -> list[str]:
        """Return the train's duties for others according to fresh heartbeats."""
        now_ns, said = self._clock.now_ns(), list[str]()
        for area, command in sorted(self._view.commands.items()):
            if now_ns - command.heard_ns > SILENT_S * NS_PER_S:
                continue
            if command.heartbeat.source == train:
                said.append(f"commands area {area}")
            elif command.heartbeat.standby == train:
                said.append(f"is standby for area {area}")
        return said

    def remove(self, train: int) -> int:
        """Report the train as gone to every master until all have taken it off their rosters."""
        if not self._view.commands:
            return self.fail_without_command()
        asked_ns, was_there = self._clock.now_ns(), False

        def answers() -> dict[int, RemovalAnswer]:
            told = self._view.removals.items()
            return {n: e for n, (e, at) in told if at >= asked_ns and e.train == train}

        def done() -> bool:
            nonlocal was_there
            for command in self._view.commands.values():
                self._remove(train, command)
            states = {area: each.state for area, each in answers().items()}
            was_there |= any(state is not RemovalState.GONE for state in states.values())
            return all(states.get(area) is RemovalState.GONE for area in self._view.commands)

        if not self.listen(ORDER_S, done):
            return _failed("; ".join(self._keepers(train, answers())))
        # Only this console can tell that the train is unknown: the wayside may have been restarted.
        if not was_there and not self._view.knows(train):
            return self._unknown(train)
        print(f"train {train} is no longer on any roster")
        return EXIT_OK

    def _keepers(self, train: int, told: Mapping[int, RemovalAnswer]) -> list[str]:
        words = []
        for area, command in sorted(self._view.commands.items()):
            if area not in told:
                words.append(f"area {area}: train {command.heartbeat.source} does not answer")
            elif told[area].state is not RemovalState.GONE:
                words.append(f"area {area} keeps train {train}: {KEPT[told[area].state]}")
        return words

    def _remove(self, train: int, command: Command) -> None:
        self._sequence += 1
        beat = command.heartbeat
        head = (SUPERVISION, beat.source, beat.area, beat.term)
        count = (self._boot, self._sequence, self._clock.now_ns())
        self._send(Removal(*head, *count, beat.stamp_ns, train))

    def _order(self, kind: OrderKind, train: int, to: int, area: int, term: int) -> None:
        """Send a command about `train` to the receiver `to`."""
        self._sequence += 1
        head = (SUPERVISION, to, area, term, self._boot, self._sequence, self._clock.now_ns())
        self._send(LineOrder(*head, kind, train))

    # Commands to the wayside.

    def decree(
        self,
        kind: DecreeKind,
        *,
        train: int = NO_TRAIN,
        start_m: float = 0.0,
        end_m: float = 0.0,
        limit_mps: float = 0.0,
    ) -> int:
        """Send the same command repeatedly until it is answered."""
        if self._view.state is None:
            return _failed("the wayside of the line is not received: no command is possible")
        if kind is DecreeKind.RELEASE and (why := self._nothing_to_release(train)):
            return _failed(f"train {train}: no emergency brake is commanded, and {why}")
        if kind in NARROWING:
            self.listen(REPORTS_S)
        self._sequence += 1
        head = (SUPERVISION, WAYSIDE, 0, 0, self._boot, self._sequence, self._clock.now_ns())
        stretch = (start_m, end_m, limit_mps)
        decree = Decree(*head, self._view.state.stamp_ns, kind, train, *stretch)

        def answered() -> bool:
            state = self._view.state
            if state is not None and _answers(state, decree):
                return True
            self._send(decree)
            return False

        if not self.listen(ORDER_S, answered):
            return _failed("the wayside does not answer; the command may or may not be in force")
        answer = self._view.state.answer
        if answer is not DecreeAnswer.DONE:
            return _failed(self._refusal(decree, answer))
        print("command in force, and stored by the wayside", flush=True)
        if kind in NARROWING:
            self._warn(SpeedRestriction(start_m, end_m, limit_mps))
        return self._shown(kind, train)

    def _warn(self, stretch: SpeedRestriction) -> None:
        """Warn about trains that may not be able to obey without an emergency brake."""
        now_ns = self._clock.now_ns()
        for train, (report, at_ns) in sorted(self._view.reports.items()):
            if now_ns - at_ns <= SILENT_S * NS_PER_S and is_near(report, stretch):
                away_m = stretch.start_m - report.front_max_m
                where = f"{away_m:.0f} m before it" if away_m > 0.0 else "in it"
                speed = f"{report.speed_mps * KMH:.0f} km/h"
                _complain(
                    f"train {train} may apply its emergency brake: it is {where} with {speed}"
                )

    def _nothing_to_release(self, train: int) -> str:
        """Return why there is nothing to release; empty if there may be.

        It is empty for a train that brakes, also by itself, and for one unknown to the wayside.
        """
        decree = self._view.decree(train)
        if decree is None or decree.emergency:
            return ""
        self.listen(ORDER_S, lambda: train in self._view.statuses)
        status = self._view.statuses.get(train)
        if status is None:
            return "the train is not received"
        return "" if status.supervision == Supervision.EMERGENCY else "none is applied"

    def _refusal(self, decree: Decree, answer: DecreeAnswer) -> str:
        areas, words = self._view.areas, REFUSALS[answer]
        if answer is DecreeAnswer.NO_STRETCH and decree.kind is DecreeKind.SKIP:
            words = NO_STATION
        words = words.format(line=areas.name, start=areas.start_m, end=areas.end_m)
        return f"{_subject(decree)}: {words}"

    def _shown(self, kind: DecreeKind, train: int) -> int:
        """Wait for the effect: a commanded brake must be on; a released one may stay on.

        A released brake may have other causes.
        """
        if kind not in (DecreeKind.EMERGENCY, DecreeKind.RELEASE):
            return EXIT_OK
        wanted = kind is DecreeKind.EMERGENCY

        def shown() -> bool:
            status = self._view.statuses.get(train)
            return status is not None and wanted is (status.supervision == Supervision.EMERGENCY)

        if self.listen(ORDER_S, shown):
            print(f"train {train}: emergency brake {'applied' if wanted else 'released'}")
            return EXIT_OK
        status = self._view.statuses.get(train)
        told = "it is not received" if status is None else protection_words(status) or "nominal"
        return _failed(f"train {train} does not show it yet: {told}")

    def _send(self, message: T2tMessage) -> None:
        key = t2t_keys.key_of(self._view.areas.name, message)
        self._port.send(
            self._clock.now_ns(), key, pack(message, self._key, database=self._database)
        )

    def fail_without_command(self, what: str = "") -> int:
        """Fail because no train commands the area, or by default any area."""
        line = self._view.areas.name
        if self._view.receives_nothing:
            return _failed(f"nothing is received on {line}")
        return _failed(f"no train commands {what or f'any area of {line}'}")

    def _unknown(self, train: int) -> int:
        return _failed(f"train {train} is unknown: no program on {self._view.areas.name} knows it")


def _answers(state: LineState, decree: Decree) -> bool:
    return (state.answered_boot, state.answered) == (decree.boot, decree.sequence)


def _subject(decree: Decree) -> str:
    """Return the train or stretch of a command as text."""
    if decree.train != NO_TRAIN:
        return f"train {decree.train}"
    stretch = stretch_words(SpeedRestriction(decree.start_m, decree.end_m, decree.limit_mps))
    if decree.kind is DecreeKind.RESTRICT:
        return f"at most {decree.limit_mps * KMH:g} km/h {stretch}"
    return stretch


def _failed(words: str) -> int:
    _complain(words)
    return EXIT_ENVIRONMENT


def _complain(words: str) -> None:
    print(f"vobc: {words}", file=sys.stderr)
