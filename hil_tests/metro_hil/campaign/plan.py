"""A campaign ready to run: its scenarios with all their points, and the resulting cases."""

import hashlib

import msgspec

from metro_hil.model.case import (
    Allowance,
    BenchKind,
    Branch,
    Case,
    ConfigTable,
    ControllerSpec,
    ExpectedFailure,
    PlantSpec,
    Setup,
)

NUMBER_DIGITS = 4
DRAWN = "drawn"
"""Design whose cases depend only on their seeds, so that the seed alone names a case."""


class SweepPoint(msgspec.Struct, frozen=True, kw_only=True):
    """One set of values for the swept keys; a scenario without a sweep has one point."""

    number: int
    """Number from 0, in the order of the design."""
    factors: ConfigTable
    setup: Setup
    faults: tuple[ConfigTable, ...]
    monitors: tuple[ConfigTable, ...]
    controller: ControllerSpec
    plant: PlantSpec
    branch: Branch | None


class ScenarioPlan(msgspec.Struct, frozen=True, kw_only=True):
    """One scenario; each of its points makes one case for each seed."""

    name: str
    title: str
    description: str
    requirements: tuple[str, ...]
    bench: BenchKind
    seeds: tuple[int, ...]
    new_seeds: bool
    """Whether each point continues the seeds where those of the point before end."""
    expected: tuple[ExpectedFailure, ...]
    vacuous: tuple[Allowance, ...]
    stop_at_violation: bool
    idle_counts: bool
    invariants: str | tuple[str, ...]
    design: str | None
    """Name of the sweep's design; None without a sweep."""
    levels: dict[str, str]
    """Text of the levels or the range, by swept key."""
    points: tuple[SweepPoint, ...]

    @property
    def case_count(self) -> int:
        return len(self.points) * len(self.seeds)

    def seeds_of(self, point: SweepPoint) -> tuple[int, ...]:
        shift = point.number * len(self.seeds) if self.new_seeds else 0
        return tuple(seed + shift for seed in self.seeds)


class Campaign(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that the campaign runs, independent of the machine."""

    name: str
    title: str
    description: str
    layout: str | None
    """Name of the printed table for this campaign's results, if it has its own."""
    scenarios: tuple[ScenarioPlan, ...]
    files: dict[str, str]
    """Contents of the user's files, by their names in the cases."""
    notes: tuple[str, ...] = ()
    """Remarks for the author, none of them an error."""

    @property
    def fingerprint(self) -> str:
        """SHA-256 over all cases and files; campaigns with equal fingerprints run equally."""
        return fingerprint(plan_cases(self), self.files)


def fingerprint(cases: tuple[Case, ...], files: dict[str, str]) -> str:
    """SHA-256 in hexadecimal over canonical JSON with sorted keys and shortest exact numbers."""
    return hashlib.sha256(msgspec.json.encode([cases, files], order="sorted")).hexdigest()


def plan_cases(campaign: Campaign) -> tuple[Case, ...]:
    """All cases in the order of the file: scenario by scenario, point by point, seed by seed."""
    cases: list[Case] = []
    for scenario in campaign.scenarios:
        for point in scenario.points:
            cases += [
                case_of(scenario, point, seed, len(cases) + place)
                for place, seed in enumerate(scenario.seeds_of(point))
            ]
    return tuple(cases)


def case_of(scenario: ScenarioPlan, point: SweepPoint, seed: int, index: int) -> Case:
    """The case of one point with one seed."""
    numbered = scenario.design not in (None, DRAWN)
    number = f"{point.number:0{NUMBER_DIGITS}d}-" if numbered else ""
    return Case(
        id=f"{scenario.name}/{number}s{seed}",
        index=index,
        scenario=scenario.name,
        seed=seed,
        setup=point.setup,
        faults=point.faults,
        monitors=point.monitors,
        invariants=scenario.invariants,
        factors=point.factors,
        requirements=scenario.requirements,
        bench=scenario.bench,
        controller=point.controller,
        plant=point.plant,
        branch=point.branch,
        expected=scenario.expected,
        vacuous=scenario.vacuous,
        stop_at_violation=scenario.stop_at_violation,
        idle_counts=scenario.idle_counts,
    )
