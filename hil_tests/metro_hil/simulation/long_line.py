"""A line of many areas with trains and a master each; measures how one area affects the others."""

from typing import Final, NamedTuple

from metro_hil.simulation.scripted_line import NS_PER_MS, Plot, ScriptedLine
from zenoh_config.timers import TIMERS_A, LineTimers

GAP_M: Final = 300.0
"""Distance between the fronts of two successive trains."""
SECTION_M: Final = 100.0
LOOK_S: Final = 0.05
SETTLE_S: Final = 20.0


class LongLine(NamedTuple):
    """Measurements of one run on the long line."""

    trains: int
    held_s: float
    """Time from the start of all programs until all trains held an authority."""
    heard_per_s: float
    """Messages received per second for each train, including those that the wayside received."""
    oldest_ms: float
    """Age of the oldest authority that any train obeyed before a master was killed."""
    followed_ms: float
    """Time from the death of the middle area's master until all its trains obeyed the next term."""
    other_terms: int
    """Number of other areas in which the term changed meanwhile."""
    emergencies: int
    """Number of emergency brakings, without those of the killed train."""


def play(
    areas: int,
    trains_each: int,
    *,
    seconds: float,
    timers: LineTimers = TIMERS_A,
    seed: int = 1,
) -> LongLine:
    """Start all trains at once and let them run closely behind each other over all borders.

    The checks of `hil simulate` apply. Raises ViolationError, and UnexpectedError if trains stay
    without authority.
    """
    area_m = GAP_M * trains_each
    trains = areas * trains_each
    fronts_m = {n + 1: areas * area_m - GAP_M / 2.0 - GAP_M * n for n in range(trains)}
    pieces = round(area_m / SECTION_M)
    scene = ScriptedLine(
        Plot(fronts_m, areas=areas, area_m=area_m, pieces=pieces, timers=timers, seed=seed)
    )
    scene.settle(SETTLE_S)
    held_s = scene.now_s
    delivered = scene.net.delivered
    oldest_ms = 0.0
    while scene.now_s < held_s + seconds:
        scene.run(LOOK_S)
        oldest_ms = max(oldest_ms, *[_age_ms(scene, train) for train in fronts_m])
    heard_per_s = (scene.net.delivered - delivered) / trains / (scene.now_s - held_s)
    followed_ms, other_terms = _killed(scene, areas)
    braked = sum(
        each.emergencies for each in scene.world.trains.values() if scene.net.runs(each.address)
    )
    return LongLine(trains, held_s, heard_per_s, oldest_ms, followed_ms, other_terms, braked)


def _age_ms(scene: ScriptedLine, train: int) -> float:
    """Return the age of the oldest authority that the train holds; 0 if it holds none."""
    node = scene.protocol(train)
    if node is None or not node.grants:
        return 0.0
    local_ns = scene.net.nodes[train].clock.local_ns(scene.net.now_ns)
    return (local_ns - min(grant.stamp_ns for grant in node.grants)) / NS_PER_MS


def _killed(scene: ScriptedLine, areas: int) -> tuple[float, int]:
    """Kill the master of the middle area once it has a standby, and wait for the next master."""
    middle = (areas + 1) // 2
    scene.until("there is a standby", lambda: scene.standby(middle) is not None, within_s=5.0)
    master = scene.master(middle)
    assert master is not None
    old = {area: _term(scene, area) for area in range(1, areas + 1)}
    followers = [
        train
        for train in scene.world.trains
        if train != master and scene.held_term(train, middle) > 0
    ]
    killed_ns = scene.net.now_ns
    scene.net.kill(master)
    scene.until(
        "all trains of the area obey the next master",
        lambda: not any(0 < scene.held_term(each, middle) <= old[middle] for each in followers),
        within_s=10.0,
    )
    followed_ms = (scene.net.now_ns - killed_ns) / NS_PER_MS
    scene.run(1.0)
    scene.expect("only the dead train has no authority", set(scene.without()) <= {master})
    return followed_ms, sum(_term(scene, area) != old[area] for area in old if area != middle)


def _term(scene: ScriptedLine, area: int) -> int:
    return max(scene.term(train, area) for train in scene.world.trains)
