"""Summarises what a campaign would run, as values and as text."""

import hashlib
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec

from metro_hil.campaign.plan import Campaign, ScenarioPlan, fingerprint, plan_cases
from metro_hil.model.case import Case, ConfigTable, ControllerSpec, plant_text


class ScenarioSummary(msgspec.Struct, frozen=True, kw_only=True):
    name: str
    title: str
    bench: str
    controller: str
    cases: int
    points: int
    seeds: int
    design: str | None
    factors: dict[str, str]
    """Text of the levels or the range, by factor."""
    faults: tuple[str, ...]
    """Texts of the first point's faults."""
    monitors: tuple[str, ...]
    invariants: str | tuple[str, ...]
    requirements: tuple[str, ...]
    expected: list[str]
    """Names of the monitors that must fail; empty for a scenario that must pass."""
    vacuous: dict[str, str]
    """Reasons by the name of a part that may show nothing."""
    simulated_s_max: float
    """Sum of the time limits of all cases, s; most cases end earlier."""


class Summary(msgspec.Struct, frozen=True, kw_only=True):
    name: str
    title: str
    description: str
    layout: str | None
    fingerprint: str
    cases: int
    simulated_s_max: float
    files: dict[str, str]
    """SHA-256 of the user's files, by their names in the cases."""
    scenarios: tuple[ScenarioSummary, ...]
    listed: tuple[str, ...]
    """Ids of the first cases, or of all."""
    notes: tuple[str, ...]


def summarise(campaign: Campaign, listed: int | None = None) -> tuple[Summary, tuple[Case, ...]]:
    """The summary and all cases; `listed` limits the ids in the summary, None lists all."""
    cases = plan_cases(campaign)
    scenarios = tuple(_scenario(scenario) for scenario in campaign.scenarios)
    summary = Summary(
        name=campaign.name,
        title=campaign.title,
        description=campaign.description,
        layout=campaign.layout,
        fingerprint=fingerprint(cases, campaign.files),
        cases=len(cases),
        simulated_s_max=sum(scenario.simulated_s_max for scenario in scenarios),
        files={
            name: hashlib.sha256(content.encode()).hexdigest()
            for name, content in campaign.files.items()
        },
        scenarios=scenarios,
        listed=tuple(case.id for case in cases[:listed]),
        notes=campaign.notes,
    )
    return summary, cases


def _scenario(plan: ScenarioPlan) -> ScenarioSummary:
    first = plan.points[0]
    limits_s = sum(point.setup.duration_s for point in plan.points)
    benches = dict.fromkeys(
        " ".join(filter(None, (plan.bench.value, plant_text(point.plant)))) for point in plan.points
    )
    controllers = dict.fromkeys(controller_words(point.controller) for point in plan.points)
    return ScenarioSummary(
        name=plan.name,
        title=plan.title,
        bench=", ".join(benches),
        controller=", ".join(controllers),
        cases=plan.case_count,
        points=len(plan.points),
        seeds=len(plan.seeds),
        design=plan.design,
        factors=plan.levels,
        faults=tuple(map(fault_words, first.faults)),
        monitors=tuple(map(monitor_words, first.monitors)),
        invariants=plan.invariants,
        requirements=plan.requirements,
        expected=[each.monitor for each in plan.expected],
        vacuous={name: each.reason for each in plan.vacuous for name in each.names},
        simulated_s_max=limits_s * len(plan.seeds),
    )


def controller_words(controller: ControllerSpec) -> str:
    return " ".join(filter(None, (controller.kind, controller.path, controller.command)))


def fault_words(table: ConfigTable) -> str:
    """Kind, parameters and window, such as `brake_late (delay_s 2.0) from 10 s for 5 s`."""
    rest = dict(table)
    words = [str(rest.pop("kind", "?"))]
    window = list(_window_words(rest))
    if rest:
        words.append(f"({', '.join(f'{name} {value}' for name, value in rest.items())})")
    return " ".join([*words, *window])


def _window_words(rest: dict[str, Any]) -> Iterator[str]:
    for name, words in (
        ("start_s", "from {} s"),
        ("when", "when {}"),
        ("duration_s", "for {} s"),
        ("end_s", "to {} s"),
        ("until", "until {}"),
    ):
        if name in rest:
            yield words.format(rest.pop(name))
    if rest.pop("repeat", False):
        yield "each time"


def monitor_words(table: Mapping[str, Any]) -> str:
    name = str(table.get("name", ""))
    what = [f"{key} {value}" for key, value in table.items() if key not in ("name", "requirements")]
    return f"{name}: {', '.join(what)}" if name else ", ".join(what)


def lines(summary: Summary) -> Iterator[str]:
    """The summary as lines of text for a person."""
    title = f": {summary.title}" if summary.title else ""
    yield f"{summary.name}{title}"
    yield (
        f"  {_count(summary.cases, 'case')} in {_count(len(summary.scenarios), 'scenario')}, "
        f"at most {_duration(summary.simulated_s_max)} of simulated time"
    )
    yield f"  fingerprint {summary.fingerprint[:16]}"
    for name, digest in summary.files.items():
        yield f"  file {name} (sha256 {digest[:16]})"
    for scenario in summary.scenarios:
        yield from _scenario_lines(scenario, summary.title)
    yield ""
    for case_id in summary.listed:
        yield f"  {case_id}"
    if len(summary.listed) < summary.cases:
        yield f"  … and {summary.cases - len(summary.listed)} more"
    for note in summary.notes:
        yield f"note: {note}"


def _scenario_lines(scenario: ScenarioSummary, above: str) -> Iterator[str]:
    """Lines of one scenario; its title is left out if it equals the campaign's."""
    title = f": {scenario.title}" if scenario.title not in ("", above) else ""
    yield ""
    yield f"{scenario.name}{title}"
    points = f"{_count(scenario.points, 'point')} ({scenario.design})" if scenario.design else ""
    seeds = _count(scenario.seeds, "seed")
    yield f"  {_count(scenario.cases, 'case')}: {f'{points} × ' if points else ''}{seeds}"
    yield f"  bench {scenario.bench}, controller {scenario.controller}"
    if scenario.expected:
        yield f"  expected to fail by {', '.join(scenario.expected)}"
    for name, reason in scenario.vacuous.items():
        yield f"  may show nothing: {name}: {reason}"
    for name, words in scenario.factors.items():
        yield f"  factor {name}: {words}"
    for fault in scenario.faults:
        yield f"  fault {fault}"
    for monitor in scenario.monitors:
        yield f"  monitor {monitor}"
    names = scenario.invariants
    yield f"  invariants {names if isinstance(names, str) else ', '.join(names) or 'none'}"
    if scenario.requirements:
        yield f"  requirements {', '.join(scenario.requirements)}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:g} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"
