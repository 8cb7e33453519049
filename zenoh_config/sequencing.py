"""Receiver-side checks of a message: destination, order and age.

Pure.

Each gate stores the newest accepted message and refuses any that is not newer. A refused message
changes only a counter.
"""

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

from zenoh_config.messages import (
    WAYSIDE,
    MovementAuthority,
    PositionReport,
    Refused,
    RefusedReason,
    TrainOrders,
    TrainStatus,
)

NS_PER_MS: Final = 1_000_000
TERM_STEP_MAX: Final = 1000
"""Greatest step of the term that one authority proves. Each change of the issuer takes one or a few
terms, so a train that runs never sees more. One that was away for months may."""


@dataclass(frozen=True, slots=True)
class _Addressee:
    """The train that answers of the wayside are for, and their maximum age on arrival."""

    train: int
    boot: int
    max_age_ns: int
    sources: frozenset[int]

    def __post_init__(self) -> None:
        assert self.max_age_ns > 0

    def objection(self, answer: MovementAuthority | TrainOrders, now_ns: int) -> Refused | None:
        """Check destination, source and age of an answer, but not its order."""
        if answer.train != self.train:
            detail = f"for train {answer.train}, this is train {self.train}"
            return Refused(RefusedReason.WRONG_DESTINATION, detail)
        if answer.source not in self.sources:
            return Refused(RefusedReason.WRONG_SOURCE, f"from {answer.source}")
        if answer.boot != self.boot:
            detail = f"for incarnation {answer.boot}, this is {self.boot}"
            return Refused(RefusedReason.WRONG_BOOT, detail)
        age_ns = now_ns - answer.echo_stamp_ns
        if age_ns < 0:
            return Refused(RefusedReason.FROM_THE_FUTURE, f"by {-age_ns // NS_PER_MS} ms")
        if age_ns > self.max_age_ns:
            return Refused(RefusedReason.TOO_OLD, f"{age_ns // NS_PER_MS} ms")
        return None


class AuthorityGate:
    """A train's gate for movement authorities."""

    def __init__(
        self,
        *,
        train: int,
        boot: int,
        max_age_ns: int,
        sources: Collection[int] = (WAYSIDE,),
        seen_term: int = 0,
        parameters: int = 0,
    ) -> None:
        """Args:
        seen_term: highest term accepted before, across restarts; lower ones are void.
        parameters: version of the train's vital parameters, which its authorities repeat.
        """
        self.refusals: Counter[RefusedReason] = Counter()
        self.accepted = 0
        self._addressee = _Addressee(train, boot, max_age_ns, frozenset(sources))
        self._newest = (seen_term, -1)
        self._leap: MovementAuthority | None = None
        """The last authority whose term leaped."""
        self._parameters = parameters

    @property
    def seen_term(self) -> int:
        return self._newest[0]

    def check(self, authority: MovementAuthority, now_ns: int) -> Refused | None:
        """Return None if the authority may be used; it then counts as the newest."""
        refused = self._objection(authority, now_ns)
        if refused is None:
            self._newest = (authority.term, authority.sequence)
            self.accepted += 1
        else:
            self.refusals[refused.reason] += 1
        return refused

    def _leaps(self, authority: MovementAuthority) -> bool:
        """Whether the term leaps, and the authority before did not have the same term.

        A single wrong term would make all later authorities void, also after a restart.
        """
        if authority.term - self._newest[0] <= TERM_STEP_MAX:
            self._leap = None
            return False
        before, self._leap = self._leap, authority
        return (
            before is None
            or before.term != authority.term
            or before.sequence >= authority.sequence
            or before.echo_stamp_ns >= authority.echo_stamp_ns
        )

    def _objection(self, authority: MovementAuthority, now_ns: int) -> Refused | None:
        refused = self._addressee.objection(authority, now_ns)
        if refused is not None:
            return refused
        if authority.parameters != self._parameters:
            return Refused(RefusedReason.OTHER_PARAMETERS, f"{authority.parameters:016x}")
        if authority.term < self._newest[0]:
            detail = f"term {authority.term}, {self._newest[0]} was seen"
            return Refused(RefusedReason.OLD_TERM, detail)
        if (authority.term, authority.sequence) <= self._newest:
            return Refused(
                RefusedReason.NOT_NEWER, f"sequence {authority.sequence}, {self._newest[1]} is held"
            )
        if self._leaps(authority):
            detail = f"term {authority.term}, {self._newest[0]} was seen; a second one confirms it"
            return Refused(RefusedReason.TERM_LEAPS, detail)
        return None


class OrdersGate:
    """A train's gate for the orders of its centre."""

    def __init__(
        self, *, train: int, boot: int, max_age_ns: int, sources: Collection[int] = (WAYSIDE,)
    ) -> None:
        self.refusals: Counter[RefusedReason] = Counter()
        self.accepted = 0
        self._addressee = _Addressee(train, boot, max_age_ns, frozenset(sources))
        self._newest = -1

    def check(self, orders: TrainOrders, now_ns: int) -> Refused | None:
        """Return None if the orders may be used; they then count as the newest."""
        refused = self._objection(orders, now_ns)
        if refused is None:
            self._newest = orders.sequence
            self.accepted += 1
        else:
            self.refusals[refused.reason] += 1
        return refused

    def _objection(self, orders: TrainOrders, now_ns: int) -> Refused | None:
        refused = self._addressee.objection(orders, now_ns)
        if refused is not None:
            return refused
        if orders.sequence <= self._newest:
            detail = f"sequence {orders.sequence}, {self._newest} is held"
            return Refused(RefusedReason.NOT_NEWER, detail)
        return None


class ReportGate:
    """The wayside's gate for one kind of report, position or status, over all trains.

    A report carries no age that the wayside could check. A stale report is harmless: its answer
    echoes the train's own stamp and is too old on arrival.
    """

    def __init__(self, *, address: int = WAYSIDE) -> None:
        self.refusals: Counter[RefusedReason] = Counter()
        self.accepted = 0
        self._address = address
        self._newest: dict[int, tuple[int, int, int]] = {}
        """By train: boot, sequence, stamp."""

    def check(self, report: PositionReport | TrainStatus) -> Refused | None:
        """Return None if the report may be used; it then counts as that train's newest."""
        refused = self._objection(report)
        if refused is None:
            self._newest[report.train] = (report.boot, report.sequence, report.stamp_ns)
            self.accepted += 1
        else:
            self.refusals[refused.reason] += 1
        return refused

    def _objection(self, report: PositionReport | TrainStatus) -> Refused | None:
        if report.destination != self._address:
            detail = f"for {report.destination}, this is {self._address}"
            return Refused(RefusedReason.WRONG_DESTINATION, detail)
        newest = self._newest.get(report.train)
        if newest is None or report.boot > newest[0]:
            return None
        boot, sequence, stamp_ns = newest
        if report.boot < boot:
            detail = f"incarnation {report.boot} of train {report.train}, {boot} was received"
            return Refused(RefusedReason.WRONG_BOOT, detail)
        if report.sequence <= sequence or report.stamp_ns < stamp_ns:
            detail = f"sequence {report.sequence} of train {report.train}, {sequence} was received"
            return Refused(RefusedReason.NOT_NEWER, detail)
        return None
