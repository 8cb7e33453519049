"""Dividing the time of a trip among its hops, against exhaustive search and by its command."""

import dataclasses
import itertools
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.settings import SettingsError
from metro_hil.energy.line import timetable_command
from metro_hil.energy.line.trip_times import HopCosts, divide, lower_hull
from plant_emulator.traffic.config import load_traffic


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


SUPPLY = 'name = "s"\n[[substations]]\njoint = "A"\nno_load_v = 836.0\nsource_ohm = 0.015\n'
SECTION = '[[sections]]\nbegin = "A"\nend = "B"\nbegin_m = 0.0\nend_m = 9000.0\nohm_per_km = 0.02\n'
TRAFFIC = 'name = "t"\nline = "hefei"\nconsist = "hefei6"\nsupply = "supply.toml"\ntrains = 2\n'
TIMES = "headway_s = 240.0\ndwell_s = 30.0\ndwell_spread_s = 5.0\n"


def test_the_command_writes_traffic_with_the_new_times(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    costs = [dataclasses.replace(hop(80.0 + n, [5.0 + n] * 9), end=f"P{n + 2}") for n in range(5)]
    monkeypatch.setattr(timetable_command, "hop_costs", lambda line, train, n, k: costs[n])
    (tmp_path / "supply.toml").write_text(SUPPLY + SECTION, encoding="utf-8")
    (tmp_path / "traffic.toml").write_text(TRAFFIC + TIMES, encoding="utf-8")
    (tmp_path / "new").mkdir()
    out = tmp_path / "new" / "found.toml"
    words = ["--save-energy", "--traffic", str(tmp_path / "traffic.toml"), "--reserve", "5"]

    assert timetable_command.main([*words, "--out", str(out)]) == 0

    assert "trip of" in capsys.readouterr().out
    found = load_traffic(str(out))
    assert len(found.runs_s) == 5
    assert sum(found.runs_s.values()) == pytest.approx(1.05 * 410.0, abs=0.3)
    assert Path(found.supply).resolve() == tmp_path / "supply.toml"
    assert tomllib.loads(out.read_text("utf-8"))["supply"] == "../supply.toml"
    assert timetable_command.main([*words, "--out", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err


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
