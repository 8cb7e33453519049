"""Finds parts of a scenario that cannot show anything, before it runs."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from firmware_py.trackdb import load_line
from metro_hil.campaign.plan import ScenarioPlan
from metro_hil.model.case import MonitorResult, Verdict
from metro_hil.model.case_setup import file_name
from metro_hil.model.service import service_of
from metro_hil.model.verdict import judges
from metro_hil.monitors import MonitorKind, MonitorPlan, read_monitors
from metro_hil.monitors.constant import Range, refuse_constant
from metro_hil.monitors.reading import FormulaError

OVERRUN_M = 500.0
"""Distance beyond the line's ends up to which the bench follows a runaway train, m."""


def empty_parts(plan: ScenarioPlan, paths: Mapping[str, Path]) -> Iterator[str]:
    """One line of text for each such part, with scenario and monitor.

    Args:
        paths: paths of the user's files, by their names in the cases.
    """
    point = plan.points[0]
    monitors = read_monitors(point.monitors, "", plan.invariants)
    if not monitors:
        yield f"{plan.name}: no monitor watches it, so each case will be vacuous"
    for name in plan.requirements:
        if not judges(name, _answers(monitors)):
            yield f"{plan.name}: {name}: no monitor judges it; name it in a [[monitor]]"
    ranges = _ranges(plan, paths)
    for monitor in monitors:
        if monitor.kind is MonitorKind.STL:
            try:
                refuse_constant(monitor.text, ranges)
            except FormulaError as error:
                yield f"{plan.name}: monitor {monitor.name}: within line and duration_s {error}"


def _answers(monitors: Sequence[MonitorPlan]) -> list[MonitorResult]:
    """Results as if each monitor had judged."""
    return [
        MonitorResult(
            name=each.name,
            verdict=Verdict.PASS,
            margin=None,
            unit=each.unit,
            requirements=each.requirements,
            own=each.own,
        )
        for each in monitors
    ]


def _ranges(plan: ScenarioPlan, paths: Mapping[str, Path]) -> tuple[tuple[str, Range], ...]:
    """Ranges of time and place in which the train of any point may be."""
    lines = [load_line(file_name(name, paths)) for name in _lines(plan)]
    trips = [trip for point in plan.points for trip in service_of(point.setup, paths)]
    lines += [trip.path.line for trip in trips]
    place = (
        min(line.start_m for line in lines) - OVERRUN_M,
        max(line.end_m for line in lines) + OVERRUN_M,
    )
    duration_s = max(point.setup.duration_s for point in plan.points)
    return ("t_s", (0.0, duration_s)), ("front_m", place), ("rear_m", place)


def _lines(plan: ScenarioPlan) -> set[str]:
    return {point.setup.line for point in plan.points}
