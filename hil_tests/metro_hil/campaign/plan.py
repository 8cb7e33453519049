"""A campaign that is ready to run: its scenarios with all their points, and the cases they make."""

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
    Setup,
)

NUMBER_DIGITS = 4
DRAWN = "drawn"
"""Design in which a case is what its seed says, so that the seed alone names it."""


class SweepPoint(msgspec.Struct, frozen=True, kw_only=True):
    """One choice of values for what a scenario sweeps; without a sweep there is one."""

    number: int
    """From 0, in the order of the design."""
    factors: ConfigTable
    setup: Setup
    faults: tuple[ConfigTable, ...]
    monitors: tuple[ConfigTable, ...]
    controller: ControllerSpec
    branch: Branch | None


class ScenarioPlan(msgspec.Struct, frozen=True, kw_only=True):
    """One scenario; its cases are its points, each with its seeds."""

    name: str
    title: str
    description: str
    requirements: tuple[str, ...]
    bench: BenchKind
    seeds: tuple[int, ...]
    new_seeds: bool
    """Whether the second point goes on where the seeds of the first end, and so on."""
    expected: tuple[ExpectedFailure, ...]
    vacuous: tuple[Allowance, ...]
    stop_at_violation: bool
    idle_counts: bool
    invariants: str | tuple[str, ...]
    design: str | None
    """None without a sweep."""
    levels: dict[str, str]
    """By swept key: the levels or the range, in words."""
    points: tuple[SweepPoint, ...]

    @property
    def case_count(self) -> int:
        return len(self.points) * len(self.seeds)

    def seeds_of(self, point: SweepPoint) -> tuple[int, ...]:
        shift = point.number * len(self.seeds) if self.new_seeds else 0
        return tuple(seed + shift for seed in self.seeds)


class Campaign(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that is to be run, and nothing that differs between machines."""

    name: str
    title: str
    description: str
    layout: str | None
    """Name of a printed table of its own."""
    scenarios: tuple[ScenarioPlan, ...]
    files: dict[str, str]
    """Files of the user: name as in the cases to content."""
    notes: tuple[str, ...] = ()
    """What its author may want to know and is not wrong."""

    @property
    def fingerprint(self) -> str:
        """SHA-256 over all cases and files; two campaigns with the same one run the same."""
        return fingerprint(plan_cases(self), self.files)


def fingerprint(cases: tuple[Case, ...], files: dict[str, str]) -> str:
    """SHA-256, hexadecimal, over canonical JSON: keys sorted, shortest exact numbers."""
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
    """One run of one point."""
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
        branch=point.branch,
        expected=scenario.expected,
        vacuous=scenario.vacuous,
        stop_at_violation=scenario.stop_at_violation,
        idle_counts=scenario.idle_counts,
    )
