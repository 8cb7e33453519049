"""Situations by chance against the worst declared motion, and mistakes that they must find."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from metro_hil.attack import curves
from metro_hil.attack.curves import attack_curve
from metro_hil.attack.oracle import DeclaredMotion, FallsUnder, follow
from metro_hil.attack.situations import LENGTHS_M, STEEPEST_PERMILLE, situation
from metro_hil.cli.hil import main
from vobc.atp import ceiling, energy_check, profile

DECLARED = DeclaredMotion(runaway_mps2=1.0, runaway_s=2.0, build_up_s=1.0, brake_mps2=1.0)
HALF_PERMILLE = -0.5 * 1000.0 / 9.81
"""A fall that accelerates a train by 0.5 m/s²."""


def test_on_level_track_the_worst_motion_is_that_of_the_hand_calculation() -> None:
    """From 10 m/s: 22 m of runaway to 12 m/s, 12 m of coasting, 72 m of braking."""
    motion = follow(FallsUnder([], 50.0), DECLARED, 100.0, 10.0, places_m=(122.0, 134.0, 300.0))

    assert motion.stop_m == pytest.approx(206.0)
    assert motion.arrivals_mps == (pytest.approx(12.0), pytest.approx(12.0), None)
    ahead = follow(FallsUnder([], 50.0), DECLARED, 100.0, 10.0, lead_s=0.5)
    assert ahead.stop_m == pytest.approx(211.0)


def test_a_fall_acts_from_the_front_on_it_until_the_rear_has_left_it() -> None:
    """A train of 50 m is on the fall from 134 to 184 m. It brakes there with 0.5 m/s²."""
    falls = FallsUnder([(134.0, 134.0 + 1e-9, HALF_PERMILLE)], 50.0)

    motion = follow(falls, DECLARED, 100.0, 10.0, places_m=(184.0,))

    assert motion.arrivals_mps[0] == pytest.approx((144.0 - 50.0) ** 0.5)
    assert motion.stop_m == pytest.approx(184.0 + 94.0 / 2.0)


def test_a_standing_train_runs_away_before_its_brake_acts() -> None:
    assert follow(FallsUnder([], 1.0), DECLARED, 0.0, 0.0).stop_m == pytest.approx(6.0)


def test_the_situations_reach_their_extremes() -> None:
    some = [situation(seed) for seed in range(60)]

    assert min(each.length_m for each in some) < 3.0
    assert max(each.length_m for each in some) > 0.5 * LENGTHS_M[1]
    assert min(each.line.start_m for each in some) < 0.0
    assert any(each.restrictions for each in some)
    assert max(len(each.line.speed_sections) for each in some) > 300
    falls = [g.gradient_permille for each in some for g in each.line.gradients]
    assert min(falls) < -0.99 * STEEPEST_PERMILLE
    assert situation(7) == situation(7) != situation(8)


@pytest.mark.parametrize("seed", range(25))
def test_the_limits_of_a_situation_are_safe(seed: int) -> None:
    assert attack_curve(seed).problem == ""


AT = ceiling.CeilingMap.at
LIMIT_UNDER = ceiling.CeilingMap._limit_under_mps
WORST_FALLS = profile._worst_falls
PULL = energy_check.EnergyCheck._pull
MISTAKES: dict[str, tuple[int, object, str, Any]] = {
    "a margin at the end of authority": (
        3,
        ceiling,
        "_NOTHING",
        ceiling._Four(0.0, 0.1, 0.2, 0.4),
    ),
    "targets from the best estimate": (
        3,
        ceiling.CeilingMap,
        "at",
        lambda self, front_m, *rest: AT(self, replace(front_m, high=front_m.best), *rest),
    ),
    "the limit ends when the front has left it": (
        1,
        ceiling.CeilingMap,
        "_limit_under_mps",
        lambda self, _rear_m, front_m, *rest: LIMIT_UNDER(self, front_m, front_m, *rest),
    ),
    "the limit ends 0.5 m before the rear has left it": (
        23,
        ceiling.CeilingMap,
        "_limit_under_mps",
        lambda self, rear_m, *rest: LIMIT_UNDER(self, rear_m + 0.5, *rest),
    ),
    "the gradient under the front alone": (
        3,
        profile,
        "_worst_falls",
        lambda line, _under_m: WORST_FALLS(line, 0.0),
    ),
    "falls that end 0.5 m too early": (
        17,
        profile,
        "_worst_falls",
        lambda line, under_m: WORST_FALLS(line, under_m - 0.5),
    ),
    "falls that end 0.5 m too early, in the second computation alone": (
        17,
        energy_check.EnergyCheck,
        "_pull",
        lambda self, at_m, covered_m: PULL(self, at_m, covered_m - 0.5),
    ),
    "no gradient while the brake builds up": (
        4,
        profile.BrakingProfile,
        "_run_on",
        lambda _self, at_m, mps, push_mps2, s: (
            at_m + (mps + 0.5 * push_mps2 * s) * s,
            mps + push_mps2 * s,
        ),
    ),
}
"""Mistakes, each with the seed of a situation that shows it."""


@pytest.mark.parametrize("name", MISTAKES)
def test_a_situation_shows_a_mistake_in_a_curve(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    seed, holder, attribute, mistake = MISTAKES[name]
    monkeypatch.setattr(holder, attribute, mistake)

    assert attack_curve(seed).problem, name


@pytest.mark.parametrize(
    ("problem", "moves", "code"), [("", True, 0), ("too fast", True, 1), ("", False, 1)]
)
def test_the_command_fails_on_an_unsafe_limit_and_on_no_evidence(
    problem: str,
    moves: bool,
    code: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    found: Callable[[int], curves.CurveFinding] = lambda seed: curves.CurveFinding(  # noqa: E731
        seed, problem, moves
    )
    monkeypatch.setattr(curves, "attack_curve", found)

    assert (
        main(["attack", "--curves", "2", "--runs", "0", "--seed", "40", "--workers", "1"]) == code
    )

    out, err = capsys.readouterr()
    assert "curves: 2 situations from seed 40" in out
    assert ("repeat: hil attack --curves 1 --runs 0 --seed 41" in err) is bool(problem)
    assert ("nothing was tried" in err) is not moves
