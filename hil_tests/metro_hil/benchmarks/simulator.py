"""Figures of trains that command themselves in virtual time: simulator, failover, headway."""

import itertools
import math
import sys
from collections.abc import Callable, Sequence
from statistics import median
from typing import Final, NamedTuple

from metro_hil.benchmarks.bench import Figure, run_measures
from metro_hil.line.headway import passages
from metro_hil.line.load import cycle_ms, waiting_cycle_ms, wayside_share
from metro_hil.simulation.batch import Total, run_many
from metro_hil.simulation.links import Weather
from metro_hil.simulation.long_line import play
from metro_hil.simulation.run import Phases
from metro_hil.simulation.scenarios.acceptance import convoy
from metro_hil.simulation.scripted_line import NS_PER_S, Plot, ScriptedLine, UnexpectedError
from metro_hil.simulation.simulate import SeedJob
from vobc.train_to_train.train import TrainCore
from zenoh_config.timers import TIMER_SETS, TIMERS_A, TIMERS_B, LineTimers

SEEDS: Final = range(1, 9)
EVENTS_BAR_PER_S: Final = 100_000.0
KILLS: Final = 20
FAILOVER_BARS_MS: Final = {"A": 450.0, "B": 200.0}
MS_PER_S: Final = 1000.0
NS_PER_MS: Final = 1_000_000
TAKEOVERS: Final = 10
TAKEOVER_DELAYS_MS: Final = (1.0, 20.0, 50.0, 100.0, 150.0, 200.0)
TAKEOVER_LOSSES: Final = (0.0, 0.05, 0.10)
TAKEOVER_BARS_MS: Final = {("A", 20.0): 450.0, ("C", 150.0): 2000.0}
TAKEOVER_MAX_S: Final = 20.0
SERVICE_RATIO: Final = 0.6
"""Share of an authority's life from which protection brakes."""
HEADWAY_TRAINS: Final = 10
HEADWAY_BAR_S: Final = 72.0
HEADWAY_FEW: Final = 4
WHOLE_TRAINS: Final = 10
WHOLE_S: Final = 71.65
"""Time between two trains at 60 km/h; ATO runs at 59.8 km/h, so the interval is 71.9 s."""
WHOLE_LOST_S: Final = 1.0
"""Time that odometry and random brake delays may cost. Trains 85 s apart lose up to 0.7 s, and
begin to brake up to 14 m before the first train."""
HEADWAY_STEP_S: Final = 1.0
DELAY_MAX_S: Final = 0.5
GROWTH_MAX_S: Final = 0.1
LOOK_S: Final = 0.05
BRAKES_MPS2: Final = 0.05
EARLIER_M: Final = 5.0
"""Random variation: the distance of a control cycle at 60 km/h, with a margin."""
SPEED_MPS: Final = 60.0 / 3.6
BEFORE_M: Final = 1000.0
RUN_UP_M: Final = 1500.0
COMMANDED: Final = 100
CYCLE_BAR_MS: Final = 200.0
LINE_AREAS: Final = 10
LINE_EACH: Final = 50
LINE_S: Final = 10.0
HEARD_BAR: Final = 1.5
STATION_M: Final = 3000.0
LENGTH_M: Final = 81.2


def events() -> list[Figure]:
    """Measure messages and steps of nodes for each second of processor time."""
    total = Total()
    for result in run_many(SEEDS, SeedJob(Phases(trouble_s=30.0)), workers=1):
        total.add(result)
    rate_per_s = total.events / total.cpu_s
    return [
        Figure(
            "simulated protocol events a CPU second",
            f"{rate_per_s:,.0f}, {total.train_s / total.cpu_s:.0f} train seconds",
            f"≥ {EVENTS_BAR_PER_S:,.0f}",
            rate_per_s >= EVENTS_BAR_PER_S,
        )
    ]


def failover() -> list[Figure]:
    """Measure the time from a master's death to the last follower's authority of the next term."""
    return [_failover(name, timers) for name, timers in (("A", TIMERS_A), ("B", TIMERS_B))]


def _failover(name: str, timers: LineTimers) -> Figure:
    took_ms = sorted(MS_PER_S * _one_failover_s(seed, timers) for seed in range(KILLS))
    bar_ms = FAILOVER_BARS_MS[name]
    return Figure(
        f"master killed, timers {name}, virtual time",
        f"median {median(took_ms):.0f} ms, worst {took_ms[-1]:.0f} ms of {KILLS}",
        f"≤ {bar_ms:.0f} ms",
        took_ms[-1] <= bar_ms,
    )


def _one_failover_s(seed: int, timers: LineTimers) -> float:
    scene = ScriptedLine(Plot(convoy(5), area_m=4000.0, timers=timers, seed=seed))
    scene.settle()
    scene.until("there is a standby", lambda: scene.standby() is not None, within_s=5.0)
    scene.run(1.0 + 0.013 * seed)
    master = scene.master()
    assert master is not None
    old = scene.held_term(master)
    followers = [train for train in scene.world.trains if train != master]
    scene.net.kill(master)
    return scene.until(
        "the followers obey the next",
        lambda: all(scene.held_term(train) > old for train in followers),
        within_s=10.0,
    )


def takeover() -> list[Figure]:
    """Measure takeovers in slow and lossy networks, for each set of timers."""
    return [
        _takeover(name, delay_ms, loss_share)
        for name in TIMER_SETS
        for delay_ms in TAKEOVER_DELAYS_MS
        for loss_share in TAKEOVER_LOSSES
    ]


def _takeover(name: str, delay_ms: float, loss_share: float) -> Figure:
    timers = TIMER_SETS[name]
    runs = [_one_takeover(seed, timers, delay_ms, loss_share) for seed in range(TAKEOVERS)]
    took_ms = sorted(MS_PER_S * took_s for took_s, _ in runs)
    braked = sum(braked for _, braked in runs)
    bar_ms = TAKEOVER_BARS_MS.get((name, delay_ms), math.inf)
    within = 2.0 * delay_ms < timers.round_trip_max_ms
    return Figure(
        f"takeover, timers {name}, {delay_ms:.0f} ms one way, loss {loss_share:.0%}",
        f"median {median(took_ms):.0f} ms, worst {took_ms[-1]:.0f} ms of {TAKEOVERS}, "
        f"{braked} trains braked" + ("" if within else "; beyond the network budget"),
        f"≤ {bar_ms:.0f} ms" if bar_ms < math.inf else "–",
        took_ms[-1] <= bar_ms,
    )


def _one_takeover(
    seed: int, timers: LineTimers, delay_ms: float, loss_share: float
) -> tuple[float, int]:
    """Time until all followers obey the next term (infinite: never), and how many braked for it."""
    scene = ScriptedLine(Plot(convoy(5), area_m=4000.0, timers=timers, seed=seed))
    scene.net.weather(
        scene.net.links(),
        Weather(int(delay_ms * NS_PER_MS), 2 * NS_PER_MS, loss_share=loss_share),
    )
    try:
        scene.settle(TAKEOVER_MAX_S)
        scene.until("there is a standby", lambda: scene.standby() is not None, within_s=5.0)
        scene.run(1.0 + 0.013 * seed)
        scene.commanded(within_s=TAKEOVER_MAX_S)
        master = scene.master()
        assert master is not None
        old = scene.held_term(master)
        followers = [train for train in scene.world.trains if train != master]
        ages: dict[int, float] = {}

        def followed() -> bool:
            for train in followers:
                grants, ratio = scene.world.drivers[train].in_force(scene.net.now_ns)
                ages[train] = max(ages.get(train, 0.0), ratio if grants else 1.0)
            return all(scene.held_term(train) > old for train in followers)

        scene.net.kill(master)
        took_s = scene.until("the followers obey the next", followed, within_s=TAKEOVER_MAX_S)
    except UnexpectedError:
        return math.inf, 0
    return took_s, sum(age > SERVICE_RATIO for age in ages.values())


def headway() -> list[Figure]:
    """Run trains of 81.2 m at 60 km/h in succession through a station with a dwell of 30 s."""
    at_bar = approach(HEADWAY_TRAINS, HEADWAY_BAR_S)
    least_s = _least_s(at_bar.undisturbed)
    queue_s, emergencies = headway_s(HEADWAY_TRAINS)
    gaps_s = [b - a for a, b in itertools.pairwise(queue_s)]
    return [
        Figure(
            f"headway, 60 km/h, dwell 30 s, {HEADWAY_TRAINS} trains",
            f"at {HEADWAY_BAR_S:.0f} s a train is delayed by {at_bar.delay_s:.1f} s at most, "
            f"{at_bar.disturbed} brake for the train ahead, {at_bar.emergencies} emergency brakes; "
            f"{least_s:.0f} s is the shortest undisturbed interval",
            f"≤ {HEADWAY_BAR_S:.0f} s",
            at_bar.undisturbed,
        ),
        Figure(
            "the same from a queue, where trains arrive slower than 60 km/h",
            f"{sum(gaps_s) / len(gaps_s):.1f} s, worst {max(gaps_s):.1f} s, "
            f"{emergencies} emergency brakes",
            "–",
            not emergencies,
        ),
    ]


def _least_s(at_bar: bool) -> float:
    """Return the shortest interval at which a few trains run undisturbed."""
    least_s = HEADWAY_BAR_S
    if at_bar:
        while approach(HEADWAY_FEW, least_s - HEADWAY_STEP_S).undisturbed:
            least_s -= HEADWAY_STEP_S
    else:
        while not approach(HEADWAY_FEW, least_s).undisturbed:
            least_s += HEADWAY_STEP_S
    return least_s


class Approach(NamedTuple):
    """Result of trains that pass the station at one interval."""

    delay_s: float
    """Greatest delay against the first train, from 1000 m before the station until leaving it."""
    growth_s: float
    """Increase of the delay from the last train but one to the last one."""
    emergencies: int
    disturbed: int
    """Number of trains that braked before the place where the first one does, which has no train
    ahead."""

    @property
    def undisturbed(self) -> bool:
        """Whether the sequence can continue without end.

        No train brakes for the one ahead, and the delay does not grow from train to train.
        """
        steady = self.growth_s <= GROWTH_MAX_S and self.delay_s <= DELAY_MAX_S
        return steady and not self.emergencies and not self.disturbed


def approach(trains: int, interval_s: float) -> Approach:
    """Start all trains at once, one interval apart at full speed, and let them reach 60 km/h."""
    gap_m = interval_s * SPEED_MPS
    station_m = gap_m * (trains - 1) + RUN_UP_M + 200.0
    plot = Plot(
        convoy(trains, first_m=200.0, gap_m=gap_m),
        area_m=station_m + 3000.0,
        stops_m=(station_m,),
        dwell_s=30.0,
        length_m=LENGTH_M,
    )
    scene = ScriptedLine(plot)
    scene.settle()
    came_s: dict[int, float] = {}
    took_s: dict[int, float] = {}
    braked_m: dict[int, float] = {}
    while len(took_s) < trains:
        scene.run(LOOK_S)
        at_s = scene.net.now_ns / NS_PER_S
        for train in scene.world.trains.values():
            if train.front_m > station_m - BEFORE_M:
                came_s.setdefault(train.address, at_s)
            if train.rear_m > station_m:
                took_s.setdefault(train.address, at_s - came_s[train.address])
            if train.address in came_s and train.motion.demand_mps2 < -BRAKES_MPS2:
                braked_m.setdefault(train.address, train.front_m)
    # The first train has no train ahead of it.
    in_order = sorted(came_s, key=lambda train: came_s[train])
    in_order_s = [took_s[train] for train in in_order]
    delay_s = max(in_order_s) - in_order_s[0]
    usual_m = braked_m[in_order[0]] - EARLIER_M
    disturbed = sum(braked_m[train] < usual_m for train in in_order[1:])
    return Approach(delay_s, in_order_s[-1] - in_order_s[-2], scene.emergencies(), disturbed)


def whole_headway() -> list[Figure]:
    """Run the same with whole controllers and plants, under the default control law."""
    told = passages(WHOLE_TRAINS, WHOLE_S)
    gaps_s = [b.stopped_s - a.stopped_s for a, b in itertools.pairwise(told)]
    mean_s = sum(gaps_s) / len(gaps_s)
    ways_s = [each.stopped_s - each.came_s for each in told]
    lost_s = max(ways_s) - ways_s[0]
    protected = sum(each.protected for each in told)
    return [
        Figure(
            f"headway of {WHOLE_TRAINS} whole trains at 60 km/h, {told[0].dwell_s:.1f} s at rest",
            f"{mean_s:.1f} s from stop to stop, {min(gaps_s):.1f} to {max(gaps_s):.1f} s, "
            f"at most {lost_s:.1f} s lost, {protected} braked by protection; they begin to brake "
            f"up to {told[0].braked_m - min(each.braked_m for each in told):.0f} m before the "
            f"place where the first one does",
            f"≤ {HEADWAY_BAR_S:.0f} s",
            mean_s <= HEADWAY_BAR_S and lost_s <= WHOLE_LOST_S and not protected,
        )
    ]


def headway_s(trains: int) -> tuple[list[float], int]:
    """Return when each train has left the station, and the number of emergency brakes."""
    first_m = STATION_M - 200.0 - 250.0 * (trains - 1)
    plot = Plot(
        convoy(trains, first_m=max(100.0, first_m), gap_m=250.0),
        area_m=6000.0,
        stops_m=(STATION_M,),
        dwell_s=30.0,
        length_m=LENGTH_M,
    )
    scene = ScriptedLine(plot)
    scene.settle()
    left_s: dict[int, float] = {}
    while len(left_s) < trains:
        scene.run(0.2)
        for train in scene.world.trains.values():
            if train.rear_m > STATION_M:
                left_s.setdefault(train.address, scene.net.now_ns / NS_PER_S)
    return sorted(left_s.values()), scene.emergencies()


def computation() -> list[Figure]:
    """Measure one cycle of a master with 100 trains on its roster: all decisions and messages."""
    took_ms, waiting_ms = cycle_ms(COMMANDED), waiting_cycle_ms(COMMANDED)
    return [
        Figure(
            f"a master's cycle, {COMMANDED} trains in its area, {_made()}",
            f"median {median(took_ms):.1f} ms, worst {max(took_ms):.1f} ms of {len(took_ms)}",
            f"≤ {CYCLE_BAR_MS:.0f} ms",
            max(took_ms) <= CYCLE_BAR_MS,
        ),
        Figure(
            f"the same, {COMMANDED} on all joints of sections, with a shadow train, {_made()}",
            f"median {median(waiting_ms):.1f} ms, worst {max(waiting_ms):.1f} ms of "
            f"{len(waiting_ms)}",
            f"≤ {CYCLE_BAR_MS:.0f} ms",
            max(waiting_ms) <= CYCLE_BAR_MS,
        ),
        Figure(
            f"the wayside of {LINE_AREAS} areas with {LINE_EACH} trains each, {_made()}",
            f"{100.0 * wayside_share(LINE_AREAS, LINE_EACH):.1f} % of a processor",
            "–",
            True,
        ),
    ]


def _made() -> str:
    """Return whether the measured code is compiled."""
    file = sys.modules[TrainCore.__module__].__file__ or ""
    return "plain Python" if file.endswith(".py") else "compiled"


def long_line() -> list[Figure]:
    """Run 500 trains in ten areas: the messages to a train depend on its area, not on the line."""
    one = play(1, LINE_EACH, seconds=LINE_S)
    many = play(LINE_AREAS, LINE_EACH, seconds=LINE_S)
    ratio = many.heard_per_s / one.heard_per_s
    bar_ms = FAILOVER_BARS_MS["A"]
    return [
        Figure(
            f"{many.trains} trains in {LINE_AREAS} areas: messages received by each in a second",
            f"{many.heard_per_s:.0f}, {ratio:.2f} times those of {one.trains} trains in one area; "
            f"all had authority {many.held_s:.2f} s after the start of their programs",
            f"≤ {HEARD_BAR} times",
            ratio <= HEARD_BAR,
        ),
        Figure(
            f"oldest authority of {many.trains} moving trains, timers A",
            f"{many.oldest_ms:.0f} ms; of {one.trains} trains in one area {one.oldest_ms:.0f} ms",
            "–",
            True,
        ),
        Figure(
            "the master in the middle killed, timers A",
            f"followed after {many.followed_ms:.0f} ms; {many.other_terms} other areas disturbed, "
            f"{many.emergencies} emergency brakes",
            f"≤ {bar_ms:.0f} ms, 0, 0",
            many.followed_ms <= bar_ms and not (many.other_terms or many.emergencies),
        ),
    ]


MEASURES: Final[dict[str, Callable[[], list[Figure]]]] = {
    "events": events,
    "failover": failover,
    "takeover": takeover,
    "headway": headway,
    "whole-headway": whole_headway,
    "computation": computation,
    "long-line": long_line,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; exit code 1 if a bar is missed."""
    return run_measures(MEASURES, "python -m metro_hil.benchmarks.simulator", str(__doc__), argv)


if __name__ == "__main__":
    sys.exit(main())
