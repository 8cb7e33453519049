"""A desk of supervision: listens, says what is wanted until it is so, tells what came of it."""

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
from zenoh_config.codec import BENCH_KEY, pack
from zenoh_config.messages import WAYSIDE, SpeedRestriction
from zenoh_config.t2t import NOBODY, SUPERVISION, LineOrder, OrderKind, T2tMessage
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
    DecreeAnswer.UNKNOWN_TRAIN: "no such train tells its status to the wayside",
    DecreeAnswer.NO_STRETCH: "no such stretch on {line}, which reaches from {start:g} to {end:g} m",
    DecreeAnswer.FULL: "no room for another one; take one back first",
    DecreeAnswer.NOT_THERE: "nothing of the kind was decreed",
    DecreeAnswer.NOT_STORED: "the wayside cannot store it, so it is not decreed",
    DecreeAnswer.TOO_OLD: "it came too late; the radio is too slow",
}
NARROWING: Final = (DecreeKind.RESTRICT, DecreeKind.CLOSE)
"""What may be too near ahead of a train."""
REPORTS_S: Final = 0.3
"""In that time every train in an area reports, also where a message is lost."""
NO_STATION: Final = "no station is ahead of it, or it does not know where it is"
KEPT: Final = {
    RemovalState.COMMITTING: "its arbiters do not keep the roster without it",
    RemovalState.HEARD: "it is heard, or was until just now; only who is silent can be taken off",
    RemovalState.AXLES: "where it may be axles are counted that no train standing there explains",
    RemovalState.TOO_OLD: "the order came too late; the radio is too slow",
}


class SupervisionConsole:
    def __init__(
        self, clock: WallClock, view: LineView, port: RadioPort, key: bytes = BENCH_KEY
    ) -> None:
        self._clock, self._view, self._port, self._key = clock, view, port, key
        epoch_ns = clock.epoch_ns()
        self._boot = epoch_ns // NS_PER_S
        # Two desks within one second number their messages on.
        self._sequence = epoch_ns % NS_PER_S // NS_PER_US

    def listen(self, duration_s: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Whether what is waited for came."""
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

    # To masters and trains.

    def switch(self, area: int, to: int) -> int:
        """Ask until another commands, or it is clear that none will."""
        if area not in self._view.commands:
            return self.nobody(f"area {area}")

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
        return _failed(f"train {to} did not take area {area} over; is it there?")

    def retire(self, train: int, *, end: bool) -> int:
        """Tell every master, for as long as it takes the train to command nothing.

        One that is to come back is told also where nobody commands: none may be left that could.
        """
        view, asked_ns = self._view, self._clock.now_ns()
        if not (view.commands or (end and train in view.reports)):
            return self.nobody()
        if not self.listen(ORDER_S, lambda: view.knows(train)):
            return self._unknown(train)

        def says_so() -> bool:
            report, at_ns = view.reports.get(train, (None, 0))
            return report is not None and at_ns >= asked_ns and report.out_of_service is not end

        def done() -> bool:
            self._serve(train, OrderKind.IN_SERVICE if end else OrderKind.OUT_OF_SERVICE)
            return says_so() and (end or not self._duties(train))

        if self.listen(ORDER_S, done):
            now = "is in service again" if end else "commands nothing and stands by for nobody"
            print(f"train {train} {now}")
            return EXIT_OK
        if not says_so():
            return _failed(
                f"train {train} does not say that it is {'in' if end else 'out of'} service"
            )
        duties = " and ".join(self._duties(train))
        print(f"train {train} is out of service; until another can take over, it goes on: {duties}")
        return EXIT_OK

    def _serve(self, train: int, kind: OrderKind) -> None:
        terms: dict[int, int] = {}
        if train in self._view.reports:
            report, _ = self._view.reports[train]
            terms[report.area] = report.term
        for area, command in self._view.commands.items():
            terms[area] = command.heartbeat.term
            self._order(kind, train, command.heartbeat.source, area, terms[area])
        # And the train itself, which says so to every master there will be.
        for area, term in terms.items():
            self._order(kind, train, train, area, term)

    def _duties(self, train: int) -> list[str]:
        """What it does for others by heartbeats that are heard."""
        now_ns, said = self._clock.now_ns(), list[str]()
        for area, command in sorted(self._view.commands.items()):
            if now_ns - command.heard_ns > SILENT_S * NS_PER_S:
                continue
            if command.heartbeat.source == train:
                said.append(f"commands area {area}")
            elif command.heartbeat.standby == train:
                said.append(f"stands by for area {area}")
        return said

    def remove(self, train: int) -> int:
        """Tell every master that it is gone, until all have taken it off their rosters."""
        if not self._view.commands:
            return self.nobody()
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
        # Nobody else can say that it is unknown: the wayside may have been started anew.
        if not was_there and not self._view.knows(train):
            return self._unknown(train)
        print(f"train {train} is on no roster any more")
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
        """That train, said to this one."""
        self._sequence += 1
        head = (SUPERVISION, to, area, term, self._boot, self._sequence, self._clock.now_ns())
        self._send(LineOrder(*head, kind, train))

    # To the wayside.

    def decree(
        self,
        kind: DecreeKind,
        *,
        train: int = NOBODY,
        start_m: float = 0.0,
        end_m: float = 0.0,
        limit_mps: float = 0.0,
    ) -> int:
        """The same decree again and again until it is answered."""
        if self._view.state is None:
            return _failed("the wayside of the line is not heard: nothing can be decreed")
        if kind is DecreeKind.RELEASE and (why := self._nothing_to_release(train)):
            return _failed(f"train {train}: no emergency brake is decreed, and {why}")
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
            return _failed("the wayside does not answer; nobody knows whether it is decreed")
        answer = self._view.state.answer
        if answer is not DecreeAnswer.DONE:
            return _failed(self._refusal(decree, answer))
        print("decreed, and stored by the wayside", flush=True)
        if kind in NARROWING:
            self._warn(SpeedRestriction(start_m, end_m, limit_mps))
        return self._shown(kind, train)

    def _warn(self, stretch: SpeedRestriction) -> None:
        """Of trains that may not be able to obey without an emergency brake."""
        now_ns = self._clock.now_ns()
        for train, (report, at_ns) in sorted(self._view.reports.items()):
            if now_ns - at_ns <= SILENT_S * NS_PER_S and is_near(report, stretch):
                away_m = stretch.start_m - report.front_max_m
                where = f"{away_m:.0f} m before it" if away_m > 0.0 else "in it"
                speed = f"{report.speed_mps * KMH:.0f} km/h"
                _complain(f"train {train} may brake by emergency: it is {where} with {speed}")

    def _nothing_to_release(self, train: int) -> str:
        """Empty for one that brakes, also of its own, and for one unknown to the wayside."""
        decree = self._view.decree(train)
        if decree is None or decree.emergency:
            return ""
        self.listen(ORDER_S, lambda: train in self._view.statuses)
        status = self._view.statuses.get(train)
        if status is None:
            return "the train is silent"
        return "" if status.supervision == Supervision.EMERGENCY else "none is applied"

    def _refusal(self, decree: Decree, answer: DecreeAnswer) -> str:
        areas, words = self._view.areas, REFUSALS[answer]
        if answer is DecreeAnswer.NO_STRETCH and decree.kind is DecreeKind.SKIP:
            words = NO_STATION
        words = words.format(line=areas.name, start=areas.start_m, end=areas.end_m)
        return f"{_subject(decree)}: {words}"

    def _shown(self, kind: DecreeKind, train: int) -> int:
        """A brake that is decreed has to be on; one that is released may have other reasons."""
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
        told = "it is silent" if status is None else protection_words(status) or "nominal"
        return _failed(f"train {train} does not show it yet: {told}")

    def _send(self, message: T2tMessage) -> None:
        key = t2t_keys.key_of(self._view.areas.name, message)
        self._port.send(self._clock.now_ns(), key, pack(message, self._key))

    def nobody(self, what: str = "") -> int:
        """Nobody commands what is meant, by default any area."""
        line = self._view.areas.name
        if self._view.receives_nothing:
            return _failed(f"nobody is heard on {line}")
        return _failed(f"nobody commands {what or f'any area of {line}'}")

    def _unknown(self, train: int) -> int:
        return _failed(
            f"train {train} is unknown: nobody has heard of it on {self._view.areas.name}"
        )


def _answers(state: LineState, decree: Decree) -> bool:
    return (state.answered_boot, state.answered) == (decree.boot, decree.sequence)


def _subject(decree: Decree) -> str:
    """Which train or stretch it is about."""
    if decree.train != NOBODY:
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
