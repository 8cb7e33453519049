"""What goes over the air, judged: who issues, on which lease, and what authority is made of.

It reads messages and knows none of the machines: it reckons leases anew from requests and answers.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from metro_hil.network.checker import ViolationError
from metro_hil.network.ground import Grant
from metro_hil.network.net import Letter
from zenoh_config.t2t import (
    AreaAuthority,
    LeaseAnswer,
    LeaseKind,
    LeaseRequest,
    SwitchKind,
    SwitchStep,
    TrainReport,
)

NS_PER_MS: Final = 1_000_000
TOLD_MAX: Final = 256


@dataclass(frozen=True, slots=True)
class LeaseRules:
    """What is agreed about leases."""

    lease_ns: int
    drift_ratio: float
    margin_ns: int
    majority: int
    age_max_ns: int


class Air:
    """One for all nodes; raises ViolationError."""

    def __init__(self, rules: LeaseRules, looked: Counter[str]) -> None:
        self.rules, self.looked = rules, looked
        self._issuers: dict[tuple[int, int], int] = {}
        """By area and term: who issues."""
        self._until_ns: dict[tuple[int, int], tuple[int, int]] = {}
        """By train and area: term of its lease, and until when by its own clock."""
        self._answers: dict[tuple[int, int, int], dict[int, int]] = {}
        """By train, area and nonce: stamp of the request that each arbiter granted."""
        self._told: dict[tuple[int, int], dict[tuple[int, int], float]] = {}
        """By train and area: ends of the authorities that came, by term and sequence."""
        self._won: set[tuple[int, int, int]] = set()
        """Train, area and term of every lease ever granted."""
        self._stale: set[tuple[int, int, int, int]] = set()
        """Train, area, term and sequence of authorities that were too old when they came."""
        self._ready: dict[tuple[int, int], int] = {}
        """By train and area: nonce of the planned switch that it last said it is ready for."""

    def stepped(
        self, address: int, now_ns: int, heard: Sequence[Any], letters: Sequence[Letter]
    ) -> None:
        """A train read something and says something, at this instant of its own clock."""
        for message in heard:
            kind = type(message)
            if kind is AreaAuthority:
                self._note_authority(address, message, now_ns)
            elif kind is LeaseAnswer:
                self._note_answer(address, message)
        for letter in letters:
            message = letter.message
            kind = type(message)
            if kind is AreaAuthority:
                self._issue(message, now_ns)
            elif kind is LeaseRequest and message.kind is LeaseKind.RELEASE:
                self._until_ns.pop((address, message.area), None)
            elif kind is TrainReport:
                self._report(message)

    def booted(self, address: int) -> None:
        """A train begins a new life: what it was told before is void."""
        memories: tuple[dict[tuple[int, int], Any], ...] = (self._told, self._until_ns)
        for memory in memories:
            for key in [key for key in memory if key[0] == address]:
                del memory[key]

    def _note_authority(self, address: int, message: AreaAuthority, now_ns: int) -> None:
        if message.destination == address:
            told = self._told.setdefault((address, message.area), {})
            number = message.term, message.sequence
            told[number] = message.end_m
            if now_ns - message.echo_ns > self.rules.age_max_ns:
                self._stale.add((address, message.area, *number))
            if len(told) > TOLD_MAX:
                del told[next(iter(told))]

    def _note_answer(self, address: int, message: LeaseAnswer) -> None:
        if not message.granted or message.destination != address:
            return
        answers = self._answers.setdefault((address, message.area, message.nonce), {})
        answers[message.source] = message.echo_ns
        if len(answers) < self.rules.majority:
            return
        newest_ns = sorted(answers.values(), reverse=True)[self.rules.majority - 1]
        until_ns = newest_ns + round(self.rules.lease_ns * (1.0 - self.rules.drift_ratio))
        key = address, message.area
        term, before_ns = self._until_ns.get(key, (0, 0))
        if message.term > term or until_ns > before_ns:
            self._until_ns[key] = message.term, until_ns
            self._won.add((address, message.area, message.term))
        if len(self._answers) > 1000:
            del self._answers[next(iter(self._answers))]

    def _issue(self, message: AreaAuthority, now_ns: int) -> None:
        self.looked["19"] += 1
        self.looked["25"] += 1
        issuer = self._issuers.setdefault((message.area, message.term), message.source)
        if issuer != message.source:
            raise ViolationError(
                "19",
                f"train {message.source} issues in area {message.area}, term {message.term}, "
                f"which is train {issuer}'s",
            )
        term, until_ns = self._until_ns.get((message.source, message.area), (0, 0))
        late_ns = now_ns - (until_ns - self.rules.margin_ns)
        if term != message.term or late_ns >= 0:
            raise ViolationError(
                "25",
                f"train {message.source} issues in area {message.area}, term {message.term}, "
                f"{late_ns / NS_PER_MS:.1f} ms after it had to stop, with a lease of term {term}",
            )

    def _report(self, report: TrainReport) -> None:
        """24, 29: what a train says that it holds was young when it came."""
        self._ready[report.source, report.area] = report.ready_nonce
        self.looked["24"] += 1
        number = report.held_term, report.held_sequence
        if self._stale and (report.source, report.area, *number) in self._stale:
            raise ViolationError(
                "24", f"train {report.source} took {number} in area {report.area}: too old it came"
            )

    def made_of(self, address: int, grant: Grant) -> None:
        """27: what a brake loop goes by was said to this train, in this life."""
        self.looked["27"] += 1
        if (address, grant.area, grant.term) in self._won:
            return
        key, number = (address, grant.area), (grant.term, grant.sequence)
        end_m = self._told.get(key, {}).get(number)
        if end_m is None or grant.end_m > end_m:
            raise ViolationError(
                "27",
                f"train {address} goes by {grant.end_m:.2f} m of area {grant.area}, term "
                f"{grant.term}, number {grant.sequence}; it was told {end_m}",
            )

    def ready_for(self, address: int, area: int) -> int:
        """The planned switch for which a train last said that it is ready; 0: none."""
        return self._ready.get((address, area), 0)


def is_commit(message: object) -> bool:
    return isinstance(message, SwitchStep) and message.kind is SwitchKind.COMMIT
