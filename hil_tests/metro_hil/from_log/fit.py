"""Fits the train of a scenario to a recorded ride.

The train alone runs again in virtual time, with the recorded commands at their recorded instants.
Its odometer must then count as the recorded one did. Gauss-Newton steps find the values for which
the sum of squared differences is least. No solver of a library takes part, so that the result does
not depend on the machine.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from can_dbc.analogue import AnalogueCommand
from can_dbc.binding import Frame
from can_dbc.brake import BrakeCommand
from can_dbc.cab import Desk
from can_dbc.doors import DoorCars, DoorCommand
from can_dbc.traction import TractionCommand
from firmware_py.settings import override
from metro_hil.from_log.ride import RecordedRide
from plant_emulator.train_config import TrainConfig
from plant_emulator.train_config.ranges import Spread
from plant_emulator.world import STEP_NS, TrainScenario, World, world_of

SAMPLE_NS: Final = 100_000_000
"""Time between two compared samples of the odometer."""
STEPS_MAX: Final = 12
HALVINGS_MAX: Final = 3
SETTLED_M: Final = 0.02
"""Improvement of the difference, root mean square, below which the fit ends."""
DAMPING_RATIO: Final = 1e-6
"""Share by which the diagonal of the normal equations is enlarged."""
SEEN_M: Final = 0.05
"""Least effect of one trial step on the odometer that shows a value, root mean square."""


@dataclass(frozen=True, slots=True)
class FittedKey:
    """A value of the consist that is fitted."""

    key: str
    """Dotted key of the consist file."""
    first: float
    trial: float
    """Change by which the effect of the value is found."""
    low: float
    high: float
    digits: int


@dataclass(frozen=True, slots=True)
class TrainFit:
    """The fitted values, and how well they describe the ride."""

    values: Mapping[str, float]
    """Values by dotted key of the consist file."""
    unseen: tuple[str, ...]
    """Keys of which the ride shows nothing; they keep the middle of the consist's range."""
    before_m: float
    """Root mean square of the odometer's difference with the consist's middle values, m."""
    after_m: float
    """The same with the fitted values, m."""
    worst_m: float
    """Greatest difference with the fitted values, m."""
    runs: int


def keys_of(train: TrainConfig) -> tuple[FittedKey, ...]:
    """What is fitted, each from the middle of its range in the consist file."""
    service = train.brake.service

    def middle(spread: Spread) -> float:
        return 0.5 * (spread.low + spread.high)

    return (
        FittedKey("brake.service.gain_ratio", middle(service.gain_ratio), 0.02, 0.3, 2.0, 4),
        FittedKey("brake.service.dead_time_s", middle(service.dead_time_s), 0.05, 0.0, 5.0, 3),
        FittedKey("resistance.error_ratio", middle(train.resistance.error_ratio), 0.1, -0.9, 5, 3),
    )


def fixed_values(train: TrainConfig) -> dict[str, float]:
    """Values that a run samples from its seed and that this fit holds at their middle."""
    lag = train.brake.service.lag_s
    return {"brake.service.lag_s": round(0.5 * (lag.low + lag.high), 3)}


def fit_train(ride: RecordedRide, scenario: TrainScenario) -> TrainFit:
    """Fit the keys of `keys_of`.

    Args:
        scenario: start, load and odometer of the ride; its train has the values that stay.
    """
    keys = keys_of(scenario.train)
    samples = _sampled(ride)
    wanted = [distance_m for _, distance_m in samples]
    instants = [at_ns for at_ns, _ in samples]
    runs = 0

    def differences(values: Sequence[float]) -> list[float]:
        nonlocal runs
        runs += 1
        changes = {key.key: value for key, value in zip(keys, values, strict=True)}
        got = simulate(ride, scenario, changes, instants)
        return [a - b for a, b in zip(got, wanted, strict=True)]

    found = least_squares(keys, differences)
    values = [round(value, key.digits) for key, value in zip(keys, found.values, strict=True)]
    last = differences(values)
    return TrainFit(
        values={key.key: value for key, value in zip(keys, values, strict=True)},
        unseen=tuple(keys[index].key for index in found.unseen),
        before_m=found.before_m,
        after_m=_rms(last),
        worst_m=max(abs(each) for each in last),
        runs=runs,
    )


def simulate(
    ride: RecordedRide,
    scenario: TrainScenario,
    changes: Mapping[str, float],
    instants: Sequence[int],
) -> list[float]:
    """Distance that the odometer has counted at each instant, under the recorded commands."""
    train = override(scenario.train, changes, scenario.train.name)
    world = world_of(replace(scenario, train=train), 0)
    receivers = _receivers(world)
    commands, at, counted = ride.commands, 0, list[float]()
    for instant_ns in instants:
        while world.now_ns + STEP_NS <= instant_ns:
            end_ns = world.now_ns + STEP_NS
            while at < len(commands) and commands[at].at_ns <= end_ns:
                heard_ns, command = commands[at]
                receivers[type(command)](command, heard_ns)
                at += 1
            world.step()
        counted.append(world.tachos.counted_m)
    return counted


def _receivers(world: World) -> Mapping[type[Frame], Callable[[Any, int], None]]:
    return {
        BrakeCommand: world.brake.hear,
        TractionCommand: world.traction.hear,
        DoorCommand: world.doors.hear,
        DoorCars: world.doors.hear_cars,
        AnalogueCommand: world.hear_currents,
        Desk: lambda desk, heard_ns: world.put_desk(desk),
    }


def _sampled(ride: RecordedRide) -> list[tuple[int, float]]:
    """The odometer's samples from the first movement on, thinned out."""
    due_ns, samples = ride.left_ns, []
    for at_ns, distance_m in ride.odometer:
        if at_ns >= due_ns:
            samples.append((at_ns, distance_m))
            due_ns = at_ns + SAMPLE_NS
    return samples


@dataclass(frozen=True, slots=True)
class LeastSquares:
    values: list[float]
    unseen: list[int]
    before_m: float


def least_squares(
    keys: Sequence[FittedKey], differences: Callable[[Sequence[float]], list[float]]
) -> LeastSquares:
    values = [key.first for key in keys]
    now = differences(values)
    before_m, unseen = _rms(now), list[int]()
    for _ in range(STEPS_MAX):
        columns = []
        for index, key in enumerate(keys):
            moved = list(values)
            trial = key.trial if values[index] + key.trial <= key.high else -key.trial
            moved[index] += trial
            changed = differences(moved)
            columns.append([(b - a) / trial for a, b in zip(now, changed, strict=True)])
        unseen = [
            index
            for index, (key, column) in enumerate(zip(keys, columns, strict=True))
            if _rms(column) * key.trial < SEEN_M
        ]
        step = _solved([[] if index in unseen else each for index, each in enumerate(columns)], now)
        better = _shortened(keys, values, step, _rms(now), differences)
        if better is None:
            break
        values, after = better
        gained_m = _rms(now) - _rms(after)
        now = after
        if gained_m < SETTLED_M:
            break
    return LeastSquares(values, unseen, before_m)


def _shortened(
    keys: Sequence[FittedKey],
    values: Sequence[float],
    step: Sequence[float],
    now_m: float,
    differences: Callable[[Sequence[float]], list[float]],
) -> tuple[list[float], list[float]] | None:
    """The step, halved until it improves the fit; None if it does not."""
    for halvings in range(HALVINGS_MAX):
        share = 0.5**halvings
        moved = [
            min(max(value + share * change, key.low), key.high)
            for key, value, change in zip(keys, values, step, strict=True)
        ]
        after = differences(moved)
        if _rms(after) < now_m:
            return moved, after
    return None


def _solved(columns: Sequence[Sequence[float]], now: Sequence[float]) -> list[float]:
    """Solve the normal equations; an empty column gives no change."""
    used = [index for index, column in enumerate(columns) if column]
    rows = [
        [_dot(columns[row], columns[column]) for column in used] + [-_dot(columns[row], now)]
        for row in used
    ]
    size = len(used)
    for row in range(size):
        # Values that the ride cannot tell apart would otherwise divide by 0.
        rows[row][row] *= 1.0 + DAMPING_RATIO
    for pivot in range(size):
        best = max(range(pivot, size), key=lambda row: abs(rows[row][pivot]))
        rows[pivot], rows[best] = rows[best], rows[pivot]
        for row in range(pivot + 1, size):
            ratio = rows[row][pivot] / rows[pivot][pivot]
            rows[row] = [a - ratio * b for a, b in zip(rows[row], rows[pivot], strict=True)]
    solution = [0.0] * size
    for row in reversed(range(size)):
        known = math.fsum(rows[row][other] * solution[other] for other in range(row + 1, size))
        solution[row] = (rows[row][size] - known) / rows[row][row]
    step = [0.0] * len(columns)
    for index, value in zip(used, solution, strict=True):
        step[index] = value
    return step


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return math.fsum(a * b for a, b in zip(one, other, strict=True))


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(_dot(values, values) / max(1, len(values)))
