"""Train-to-train control exactly as [Xu] describes it, to show where it fails.

Its rules: a train asks all others and becomes master if none of them is. A train that receives no
master takes over at once. During a planned switch the old and the new master both compute, "because
any moving authorization is safe". A third party that finds two masters picks one of them. Terms,
leases and reservations are missing because the paper has none.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from metro_hil.simulation.checker import Rules
from metro_hil.simulation.node import NEVER, NodeMachine, NodeStep, QueuedMessage, SimulatedNode
from metro_hil.simulation.true_train import BrakeLoopGrant, OdometryReading

NS_PER_MS: Final = 1_000_000
CYCLE_NS: Final = 200 * NS_PER_MS
ASKING_NS: Final = 400 * NS_PER_MS
SILENT_NS: Final = 800 * NS_PER_MS
MARGIN_M: Final = 3.0
"""Distance to the minimum safe rear of the train ahead, in addition to its possible rollback."""


@dataclass(frozen=True, slots=True)
class Ask:
    train: int


@dataclass(frozen=True, slots=True)
class Reply:
    train: int
    is_master: bool


@dataclass(frozen=True, slots=True)
class Report:
    train: int
    stamp_ns: int
    reading: OdometryReading


@dataclass(frozen=True, slots=True)
class Authorization:
    train: int
    issuer: int
    end_m: float
    echo_ns: int


@dataclass(frozen=True, slots=True)
class MasterRuling:
    """Ruling of the third party: this train stays master."""

    master: int


@dataclass(frozen=True, slots=True)
class PaperSettings:
    trains: tuple[int, ...]
    third_party: int
    line_end_m: float
    roll_back_m: float


@dataclass(slots=True)
class PaperTrain:
    """One train. It forgets everything when it dies, because the paper names no memory."""

    address: int
    settings: PaperSettings
    grants: tuple[BrakeLoopGrant, ...] = ()
    master: bool = False
    _asking_until_ns: int | None = None
    _heard_master_ns: int = 0
    _due_ns: int = 0
    _count: int = 0
    _reports: dict[int, Report] = field(default_factory=dict)

    def step(self, now_ns: int, heard: Sequence[Any], reading: OdometryReading) -> NodeStep:
        said: list[QueuedMessage] = []
        others = tuple(each for each in self.settings.trains if each != self.address)
        for message in heard:
            said += self._answer(message, now_ns)
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + CYCLE_NS
            report = Report(self.address, now_ns, reading)
            self._reports[self.address] = report
            said.append(QueuedMessage(others, report))
            said += self._decide(now_ns, others)
            if self.master:
                said += self._authorize(now_ns)
        return NodeStep(said, None, self._due_ns)

    def _answer(self, message: Any, now_ns: int) -> list[QueuedMessage]:
        match message:
            case Ask(train):
                return [QueuedMessage((train,), Reply(self.address, self.master))]
            case Reply(_, is_master) if is_master:
                self._asking_until_ns, self._heard_master_ns = None, now_ns
            case Report(train):
                self._reports[train] = message
            case Authorization(_, issuer, end_m, echo_ns):
                self._hold(end_m, issuer, echo_ns, now_ns)
            case MasterRuling(master):
                self.master = master == self.address
        return []

    def _hold(self, end_m: float, issuer: int, echo_ns: int, now_ns: int) -> None:
        """Accept the newest authorization, as the paper holds any authorization to be safe."""
        self._heard_master_ns = now_ns
        self._count += 1
        self.grants = (BrakeLoopGrant(end_m, 0, self._count, issuer, 1, echo_ns),)

    def _decide(self, now_ns: int, others: tuple[int, ...]) -> list[QueuedMessage]:
        if self.master or now_ns - self._heard_master_ns < SILENT_NS:
            return []
        if self._asking_until_ns is None:
            self._asking_until_ns = now_ns + ASKING_NS
            return [QueuedMessage(others, Ask(self.address))]
        if now_ns >= self._asking_until_ns:
            self._asking_until_ns, self.master = None, True
        return []

    def _authorize(self, now_ns: int) -> list[QueuedMessage]:
        """Authorise each known train up to the train ahead of it."""
        letters = []
        for report in self._reports.values():
            front_m = report.reading.front_max_m
            ahead_m = [
                other.reading.rear_min_m - MARGIN_M - self.settings.roll_back_m
                for other in self._reports.values()
                if other.reading.front_max_m > front_m
            ]
            end_m = min([self.settings.line_end_m, *ahead_m])
            if report.train == self.address:
                self._hold(end_m, self.address, report.stamp_ns, now_ns)
                letters.append(
                    QueuedMessage((self.settings.third_party,), self._told(report, end_m))
                )
            else:
                letters.append(QueuedMessage((report.train,), self._told(report, end_m)))
        return letters

    def _told(self, report: Report, end_m: float) -> Authorization:
        return Authorization(report.train, self.address, end_m, report.stamp_ns)


@dataclass(slots=True)
class ThirdParty:
    """Watches which trains authorise themselves; of two it keeps the one with the lower number."""

    settings: PaperSettings
    _heard_ns: dict[int, int] = field(default_factory=dict)

    def step(self, now_ns: int, heard: Sequence[Any]) -> NodeStep:
        for message in heard:
            if isinstance(message, Authorization):
                self._heard_ns[message.issuer] = now_ns
        masters = [each for each, at in self._heard_ns.items() if now_ns - at < SILENT_NS]
        if len(masters) < 2:
            return NodeStep((), None, NEVER)
        self._heard_ns.clear()
        return NodeStep(
            [QueuedMessage(self.settings.trains, MasterRuling(min(masters)))], None, NEVER
        )


class PaperNodes:
    """The paper's protocol on all nodes. It has no terms, so checks of terms do not apply."""

    rules: Final = Rules(age_max_ns=1500 * NS_PER_MS, unjudged=frozenset({"19", "20", "29"}))

    def __init__(self, settings: PaperSettings) -> None:
        self._settings = settings

    def train(self, node: SimulatedNode, now_ns: int) -> PaperTrain:
        return PaperTrain(node.address, self._settings)

    def installed(self, address: int) -> None:
        return None

    def wayside(self) -> Mapping[int, tuple[str, Callable[[SimulatedNode, int], NodeMachine]]]:
        def start(node: SimulatedNode, now_ns: int) -> NodeMachine:
            return ThirdParty(self._settings)

        return {self._settings.third_party: ("third party", start)}
