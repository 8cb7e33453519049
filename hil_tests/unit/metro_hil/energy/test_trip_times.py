"""Dividing the time of a trip among its hops, against exhaustive search and by its command."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.settings import SettingsError
from metro_hil.energy.line import timetable_command
from metro_hil.energy.line.trip_times import HopCosts, divide, lower_hull


def hop(fastest_s: float, falls_j: list[float]) -> HopCosts:
    """A hop that saves this much with each second after its fastest run."""
    falls = sorted(falls_j, reverse=True)
    times_s = fastest_s + np.arange(len(falls) + 1.0)
    return HopCosts("a", "b", times_s, 100.0 - np.concatenate([[0.0], np.cumsum(falls)]))


hops = st.builds(hop, st.floats(50.0, 90.0), st.lists(st.floats(0.1, 9.0), min_size=3, max_size=3))


@settings(max_examples=60, deadline=None)
@given(both=st.tuples(hops, hops), more_s=st.integers(0, 6))
def test_no_other_division_in_whole_seconds_takes_less_energy(
    both: tuple[HopCosts, HopCosts], more_s: int
) -> None:
    fastest_s = [each.fastest_s for each in both]

    runs_s = divide(both, sum(fastest_s) + more_s)

    assert sum(runs_s) == pytest.approx(sum(fastest_s) + more_s)
    found_j = sum(each.energy_j(run_s) for each, run_s in zip(both, runs_s, strict=True))
    for first_s in range(more_s + 1):
        other_j = both[0].energy_j(fastest_s[0] + first_s)
        other_j += both[1].energy_j(fastest_s[1] + more_s - first_s)
        assert found_j <= other_j + 1e-6


def test_time_that_saves_nothing_is_shared_and_too_little_time_is_refused() -> None:
    both = (hop(50.0, [1.0]), hop(99.0, [1.0]))

    assert divide(both, 302.0) == pytest.approx([102.0, 200.0])
    with pytest.raises(SettingsError, match=r"a trip of 140\.0 s: the fastest runs take 149\.0 s"):
        divide(both, 140.0)


@given(
    energies_j=st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=12),
    times_s=st.lists(st.floats(1.0, 99.0), min_size=12, max_size=12),
)
def test_the_hull_is_convex_and_under_all_points(
    energies_j: list[float], times_s: list[float]
) -> None:
    times, energies = np.array(times_s[: len(energies_j)]), np.array(energies_j)

    kept_s, kept_j = lower_hull(times, energies)

    assert kept_s[0] == times.min()
    assert kept_j[-1] == energies.min()
    slopes = [float(b - a) for a, b in itertools.pairwise(np.interp(kept_s, kept_s, kept_j))]
    assert all(slope < 0.0 for slope in slopes)
    assert np.all(np.interp(times, kept_s, kept_j) <= energies + 1e-6)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--line", "hefei"], "vobc: --train: is missing; hefei needs a train or --traffic"),
        (["--line", "hefei", "--train", "hefei7"], "vobc: hefei7: nearest valid train: hefei6"),
        (["--reserve", "9"], "vobc: --reserve: only with another line, or with --traffic"),
        (["--traffic", "none.toml"], "vobc: none.toml: no such file"),
    ],
)
def test_options_that_do_not_fit_get_one_line(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert timetable_command.main(["--save-energy", *words]) == 2
    assert capsys.readouterr().err.strip() == complaint
