"""The two computations of the emergency limit compared, with both healthy or one broken."""

import math
import random
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import pytest

from firmware_py.trackdb import LineMap
from metro_hil.metrics.worst_motion import (
    CONFIG,
    CYCLE_S,
    KMH,
    ceilings,
    intervals,
    limits,
    line_of,
    sections,
)
from vobc.atp.config import AtpConfig
from vobc.atp.energy_check import EnergyCheck, Replicas
from vobc.vocabulary import Interval, Restriction

LINES = 300
STATES_A_LINE = 80
FAR_M = 1e6
LENGTH_M = 68.59
BAND_MPS = CONFIG.replica_band_mps
AGREED_MPS = 1e-4
"""Largest difference between the two computations in practice, m/s."""
OFF_MPS = (-0.4, -0.12, 0.12, 0.4)
"""Speeds of the test relative to the ceiling's limit, m/s. A small fault shows only near the
limit."""


@dataclass(frozen=True, slots=True)
class State:
    """Inputs given to both computations."""

    front_m: Interval
    speed_mps: float
    end_m: float
    restrictions: tuple[Restriction, ...]


def line_by_chance(rng: random.Random) -> LineMap:
    pieces = [
        (rng.choice((0.0, 0.0, 3.0, 120.0)), rng.uniform(5.0, 400.0), rng.uniform(-40.0, 40.0))
        for _ in range(rng.randint(0, 12))
    ]
    changes = [
        (rng.uniform(50.0, 3500.0), rng.uniform(3.0, 25.0)) for _ in range(rng.randint(0, 6))
    ]
    return line_of(sections(pieces), limits(rng.uniform(8.0, 25.0), changes))


def state_by_chance(rng: random.Random) -> State:
    front_m = intervals(rng.uniform(50.0, 3000.0), rng.uniform(0.0, 12.0), rng.uniform(0.0, 12.0))
    starts_m = [rng.uniform(0.0, 3000.0) for _ in range(rng.randint(0, 2))]
    return State(
        front_m,
        rng.uniform(0.0, 28.0),
        front_m.high + rng.uniform(-5.0, 700.0),
        tuple(
            Restriction(start_m, start_m + rng.uniform(1.0, 500.0), rng.uniform(1.0, 20.0))
            for start_m in starts_m
        ),
    )


def states(
    *,
    seed: int = 1,
    of_ceiling: AtpConfig = CONFIG,
    of_check: AtpConfig = CONFIG,
    mistaken_sign: bool = False,
) -> Iterator[tuple[State, float, EnergyCheck]]:
    """Random states with the ceiling's emergency limit and the energy check beside it."""
    rng = random.Random(seed)
    for _ in range(LINES):
        line, length_m = line_by_chance(rng), rng.uniform(18.0, 160.0)
        mirrored = uphill_down(line) if mistaken_sign else line
        ceiling_map = ceilings(line, length_m=length_m, config=of_ceiling)
        check = EnergyCheck(of_check, mirrored, train_length_m=length_m, cycle_s=CYCLE_S)
        for _ in range(STATES_A_LINE):
            state = state_by_chance(rng)
            ceiling = ceiling_map.at(state.front_m, state.end_m, state.restrictions)
            yield state, ceiling.emergency_mps, check


def uphill_down(line: LineMap) -> LineMap:
    """The line with the signs of its gradients inverted."""
    return replace(
        line,
        gradients=tuple(
            replace(section, gradient_permille=-section.gradient_permille)
            for section in line.gradients
        ),
    )


def exceeded(check: EnergyCheck, state: State, speed_mps: float) -> bool:
    return check.exceeded(state.front_m, speed_mps, state.end_m, state.restrictions)


def test_both_computations_find_the_same_limit_in_24000_states() -> None:
    """The differences are far inside the band: energy is exceeded just above the ceiling's limit
    and not just below."""
    met = 0
    for state, emergency_mps, check in states():
        assert exceeded(check, state, emergency_mps + AGREED_MPS), state
        if emergency_mps > AGREED_MPS:
            assert not exceeded(check, state, emergency_mps - AGREED_MPS), state
        met += 1

    assert met == LINES * STATES_A_LINE
    assert AGREED_MPS < BAND_MPS


def disagreements(found: Iterator[tuple[State, float, EnergyCheck]]) -> Iterator[State]:
    """States near the limit in which two computations without tolerance differ."""
    strict = replace(CONFIG, replica_cycles_max=0)
    for index, (state, emergency_mps, check) in enumerate(found):
        speed_mps = max(0.0, emergency_mps + OFF_MPS[index % len(OFF_MPS)])
        if not Replicas(strict, check).agree(
            emergency_mps, state.front_m, speed_mps, state.end_m, state.restrictions
        ):
            yield state


def disagree_in(count: int, found: Iterator[tuple[State, float, EnergyCheck]]) -> bool:
    """Whether they differ in at least so many of all states; the rest is not looked at."""
    return len(list(islice(disagreements(found), count))) == count


def test_healthy_computations_never_disagree_in_tens_of_thousands_of_states() -> None:
    assert list(disagreements(states(seed=2))) == []


WRONG = {
    "guaranteed rate too high": {"guaranteed_decel_mps2": 1.1},
    "guaranteed rate too low": {"guaranteed_decel_mps2": 0.9},
    "runaway forgotten": {"runaway_mps2": 0.0},
    "cut too quick": {"traction_cut_s": 0.1},
    "build-up forgotten": {"brake_build_up_s": 0.5},
    "margin too wide": {"emergency_margin_mps": 12.0 * KMH},
}


@pytest.mark.parametrize("fault", list(WRONG))
def test_a_fault_in_one_is_caught_by_the_other(fault: str) -> None:
    """The test breaks the ceiling in one run and the check in the other."""
    broken = replace(CONFIG, **WRONG[fault])  # type: ignore[arg-type]

    assert disagree_in(101, states(of_ceiling=broken))
    assert disagree_in(101, states(of_check=broken))


def test_a_mistaken_sign_of_the_gradient_is_caught() -> None:
    assert disagree_in(1001, states(mistaken_sign=True))


LEVEL = line_of((), ((0.0, 6000.0, 20.0),))
LEVEL_CHECK = EnergyCheck(CONFIG, LEVEL, train_length_m=LENGTH_M, cycle_s=CYCLE_S)
AT_1000 = intervals(1000.0, 0.0, 0.0)
TOLERATED_MPS = 20.0 + CONFIG.emergency_margin_mps


def agreement(emergency_mps: float, speed_mps: float) -> bool:
    """Whether two computations without tolerance agree on an open line with a limit of 20 m/s."""
    replicas = Replicas(replace(CONFIG, replica_cycles_max=0), LEVEL_CHECK)
    return replicas.agree(emergency_mps, AT_1000, speed_mps, FAR_M)


@pytest.mark.parametrize(
    ("emergency_mps", "speed_mps", "agree"),
    [
        (TOLERATED_MPS, TOLERATED_MPS, True),
        (TOLERATED_MPS, TOLERATED_MPS - 5.0, True),
        (TOLERATED_MPS, TOLERATED_MPS + 5.0, True),
        # The check reports an exceedance; the ceiling is below its limit by a little less or more
        # than the band.
        (TOLERATED_MPS + BAND_MPS - 1e-9, TOLERATED_MPS, True),
        (TOLERATED_MPS + BAND_MPS + 1e-9, TOLERATED_MPS, False),
        # The ceiling reports an exceedance; the check is below its limit by a little less or more
        # than the band.
        (10.0, TOLERATED_MPS - BAND_MPS + 1e-9, True),
        (10.0, TOLERATED_MPS - BAND_MPS - 1e-9, False),
        (math.nan, TOLERATED_MPS + 1.0, False),
        (math.nan, TOLERATED_MPS - 1.0, False),
    ],
)
def test_the_computations_differ_just_outside_the_band_and_not_inside(
    emergency_mps: float, speed_mps: float, agree: bool
) -> None:
    assert agreement(emergency_mps, speed_mps) is agree


def test_disagreement_is_tolerated_for_the_configured_number_of_cycles() -> None:
    replicas = Replicas(CONFIG, LEVEL_CHECK)

    def cycle(emergency_mps: float) -> bool:
        return replicas.agree(emergency_mps, AT_1000, 15.0, FAR_M)

    differing, fine = 10.0, TOLERATED_MPS
    assert CONFIG.replica_cycles_max == 2
    assert [cycle(differing), cycle(differing), cycle(differing)] == [True, True, False]
    assert [cycle(fine), cycle(differing), cycle(differing)] == [True, True, True]
    assert cycle(differing) is False


def test_protection_can_read_the_result_of_the_check() -> None:
    replicas = Replicas(CONFIG, LEVEL_CHECK)

    replicas.agree(TOLERATED_MPS + 10.0, AT_1000, TOLERATED_MPS, FAR_M)
    assert replicas.exceeded
    replicas.agree(TOLERATED_MPS, AT_1000, TOLERATED_MPS - 1e-9, FAR_M)
    assert not replicas.exceeded


def test_energy_at_a_limit_counts_as_exceeded_under_the_train_and_ahead() -> None:
    slow = Restriction(1000.0, 1100.0, 5.0)
    tolerated_mps = 5.0 + CONFIG.emergency_margin_mps

    for front_m in (1000.0, 1050.0, 1100.0 + LENGTH_M - 1e-6):
        front = intervals(front_m, 0.0, 0.0)
        assert LEVEL_CHECK.exceeded(front, tolerated_mps, FAR_M, (slow,))
        assert not LEVEL_CHECK.exceeded(front, tolerated_mps - 1e-9, FAR_M, (slow,))
    clear = intervals(1100.0 + LENGTH_M, 0.0, 0.0)
    assert not LEVEL_CHECK.exceeded(clear, tolerated_mps + 5.0, FAR_M, (slow,))


@pytest.mark.parametrize(
    ("front_m", "speed_mps"),
    [
        (Interval(900.0, 950.0, 1000.0), 0.0),
        (Interval(900.0, 950.0, 1001.0), -3.0),
        (Interval(math.nan, 950.0, 960.0), 1.0),
        (Interval(900.0, 950.0, math.inf), 1.0),
        (Interval(900.0, 900.0, 900.0), math.nan),
    ],
)
def test_at_the_end_of_authority_and_for_non_finite_inputs_energy_is_exceeded(
    front_m: Interval, speed_mps: float
) -> None:
    assert LEVEL_CHECK.exceeded(front_m, speed_mps, 1000.0)
    assert LEVEL_CHECK.exceeded(AT_1000, 1.0, math.nan)


def test_a_train_that_rolls_back_counts_as_standing() -> None:
    assert not LEVEL_CHECK.exceeded(AT_1000, -30.0, 1002.0)
    assert LEVEL_CHECK.exceeded(AT_1000, -30.0, 1000.2), "the runaway alone takes it there"


def test_on_a_fall_steeper_than_the_brake_energy_is_always_exceeded() -> None:
    """`CeilingMap` refuses such a line, but the check does not rely on that."""
    cliff = EnergyCheck(
        CONFIG, line_of(((0.0, 6000.0, -110.0),)), train_length_m=LENGTH_M, cycle_s=CYCLE_S
    )

    assert cliff.exceeded(AT_1000, 1.0, 5000.0)
