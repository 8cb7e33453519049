"""Tuning: searches on functions with a known minimum, the rules, and the written file."""

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest

from firmware_py.settings import SettingsError
from metro_hil.cli import vobc
from metro_hil.model.case import Case, CaseResult, Verdict
from metro_hil.run.dispatch import run_case
from metro_hil.tuning import DEFAULTS, PARAMETERS, Tuned, Tuner, chosen_parameters, command
from metro_hil.tuning.leave import parameter_file
from metro_hil.tuning.nelder_mead import NelderMead
from metro_hil.tuning.objective import cost_cm
from metro_hil.tuning.parameters import value_of
from metro_hil.tuning.training import TRAINING, VALIDATION, Ground
from vobc.config import load_config

GROUND = Ground("pid", "florence", "florence4", "florence4")
KEYS = ("ato.pid.position.kp_per_s", "ato.pid.position.kd_ratio")


def result_of(case: Case, **measures: float) -> CaseResult:
    usual: dict[str, float | None] = {
        "stop_error_mean_m": 0.02,
        "stop_error_worst_m": 0.02,
        "stops_missed_count": 0.0,
        "arrived_count": 1.0,
        "stop_III_run_s": 80.0,
        "jerk_max_mps3": 0.6,
        "emergency_count": 0.0,
    }
    return CaseResult(
        case_id=case.id, index=case.index, verdict=Verdict.PASS, measures={**usual, **measures}
    )


class Bench:
    """Replaces the simulation: the error grows with the distance from the best gains."""

    def __init__(self, best: dict[str, float], *, ends_after: int | None = None) -> None:
        self._best = best
        self._ends_after = ends_after
        self.seeds: set[int] = set()
        self.runs = 0

    def __call__(self, cases: Sequence[Case]) -> Sequence[CaseResult]:
        results = []
        for case in cases:
            self.runs += 1
            if self._ends_after is not None and self.runs > self._ends_after:
                raise KeyboardInterrupt
            self.seeds.add(case.seed)
            off = sum(
                abs(case.setup.believed[key] / best - 1.0) for key, best in self._best.items()
            )
            error_m = 0.005 + 0.02 * off
            results.append(result_of(case, stop_error_mean_m=error_m, stop_error_worst_m=error_m))
        return results


BEST = {KEYS[0]: 0.2, KEYS[1]: 0.6}


def tuner(bench: Bench, *, budget: int = 240, **chosen: Any) -> Tuner:
    parameters = chosen_parameters("pid", KEYS)
    config = load_config("florence4")
    before = {parameter.key: value_of(config, parameter.key) for parameter in parameters}
    return Tuner(GROUND, parameters, before, bench, budget=budget, seed=1, **chosen)


@pytest.mark.parametrize("method", ["nelder-mead", "cma-es"])
def test_the_best_settings_are_found(method: str) -> None:
    tuning = tuner(Bench(BEST), budget=720, method=method)
    tuning.train()

    tuned = tuning.tuned
    assert tuned.after[KEYS[0]] == pytest.approx(0.2, rel=0.15)
    assert tuned.after[KEYS[1]] == pytest.approx(0.6, rel=0.15)
    assert tuned.cost_after_m < tuned.cost_before_m


@pytest.mark.parametrize("method", ["nelder-mead", "cma-es"])
def test_the_same_seed_gives_the_same_file(method: str) -> None:
    texts = []
    for _ in range(2):
        tuning = tuner(Bench(BEST), method=method)
        tuning.train()
        tuning.judge()
        texts.append(parameter_file(GROUND, tuning.tuned, {"seed": 1}))

    assert texts[0] == texts[1]


def test_the_budget_is_respected_and_the_judging_uses_other_seeds() -> None:
    bench = Bench(BEST)
    tuning = tuner(bench, budget=60)
    tuning.train()

    assert bench.runs == tuning.tuned.runs == 60
    trained, bench.seeds = bench.seeds, set()
    assert len(trained) == TRAINING
    tuning.judge()
    assert bench.runs == 60 + 2 * VALIDATION
    assert trained.isdisjoint(bench.seeds)


def test_results_before_ctrl_c_are_kept() -> None:
    tuning = tuner(Bench(BEST, ends_after=10 * TRAINING))
    with pytest.raises(KeyboardInterrupt):
        tuning.train()

    assert tuning.begun
    assert tuning.tuned.cost_after_m <= tuning.tuned.cost_before_m
    assert tuning.tuned.figures_after is None


def test_the_result_is_never_worse_than_the_initial_settings() -> None:
    """The initial settings are already the best ones."""
    config = load_config("florence4")
    tuning = tuner(Bench({key: value_of(config, key) for key in KEYS}), budget=60)
    tuning.train()

    assert tuning.tuned.after == tuning.tuned.before


def test_the_file_is_usable_and_names_its_origin(tmp_path: Path) -> None:
    tuned = Tuned(
        before={KEYS[0]: 0.4, KEYS[1]: 1.0},
        after={KEYS[0]: 0.21, KEYS[1]: 1.7},
        cost_before_m=0.03,
        cost_after_m=0.02,
        points=4,
        runs=24,
    )
    path = tmp_path / "tuned.toml"
    path.write_text(parameter_file(GROUND, tuned, {"seed": 7, "budget": 24}), encoding="utf-8")

    config = load_config(str(path))
    shipped = load_config("florence4")
    assert config.ato.strategy == "pid"
    assert config.ato.pid.position.kp_per_s == 0.21
    assert config.ato.pid.position.kd_ratio == 1.7
    assert config.ato.pid.falling == shipped.ato.pid.falling
    assert (config.atp, config.odometry, config.train) == (
        shipped.atp,
        shipped.odometry,
        shipped.train,
    )
    head = path.read_text(encoding="utf-8").split("\n\n")[0]
    for words in ("law: pid", "line: florence", "seed: 7", "budget: 24", "24 of training"):
        assert words in head


def test_nelder_mead_descends_a_curved_valley() -> None:
    """Rosenbrock's function over the square -2..2 has its minimum at (1, 1)."""

    def rosenbrock(shares: Sequence[float]) -> float:
        x, y = (4.0 * share - 2.0 for share in shares)
        return (1.0 - x) ** 2 + 100.0 * (y - x * x) ** 2

    search = NelderMead((0.3, 0.8), seed=1)
    least = min(rosenbrock((0.3, 0.8)), 1e9)
    for _ in range(400):
        asked = search.ask()
        assert all(0.0 <= share < 1.0 for point in asked for share in point)
        values = [rosenbrock(point) for point in asked]
        least = min(least, *values)
        search.tell(values)

    assert least < 1e-3


def test_a_missed_stop_outweighs_centimetres() -> None:
    case = GROUND.training({}, 1)[0]
    made, missed = result_of(case), result_of(case, arrived_count=0.0)

    assert cost_cm([made], 80.0, notches=False) == pytest.approx(2.0)
    assert cost_cm([missed], 80.0, notches=False) > 100.0
    assert cost_cm([result_of(case, stop_III_run_s=90.0)], 80.0, notches=False) == pytest.approx(
        3.0
    )
    assert cost_cm([result_of(case, stop_III_run_s=60.0)], 80.0, notches=False) == pytest.approx(
        2.0
    )


def test_notches_count_only_beyond_fifteen_changes() -> None:
    case = GROUND.training({}, 1)[0]

    few = result_of(case, notch_changes_max_count=15.0)
    many = result_of(case, notch_changes_max_count=19.0)

    assert cost_cm([few], 80.0, notches=True) == pytest.approx(2.0)
    assert cost_cm([many], 80.0, notches=True) == pytest.approx(4.0)
    assert cost_cm([many], 80.0, notches=False) == pytest.approx(2.0)
    assert not GROUND.by_notches
    assert dataclasses.replace(GROUND, law="chasing").by_notches


@pytest.mark.parametrize("law", sorted(PARAMETERS))
def test_every_setting_of_the_table_exists_and_lies_within_its_bounds(law: str) -> None:
    config = load_config("florence4")

    for parameter in PARAMETERS[law]:
        assert parameter.low < parameter.high
        assert parameter.low <= value_of(config, parameter.key) <= parameter.high
        for share in (0.0, 0.25, 1.0):
            value = parameter.value(share)
            assert parameter.share_ratio(value) == pytest.approx(share, abs=1e-3)
    assert set(DEFAULTS[law]) <= {parameter.key for parameter in PARAMETERS[law]}


def test_the_training_runs_differ_in_load_odometer_delay_and_seed() -> None:
    cases = GROUND.training({}, 1)

    assert {case.setup.load_ratio for case in cases} == {0.0, 0.5, 1.0}
    assert len({case.setup.odometer_error for case in cases}) > 1
    assert len({msgspec.json.encode(case.setup.real) for case in cases}) > 1
    assert len({case.seed for case in cases}) == TRAINING


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--law", "pidd"], "--law pidd"),
        (["--parameters", "ato.pid.position.kp"], "--parameters ato.pid.position.kp"),
        (["--line", "nowhere"], "nowhere"),
        (["--consist", "nothing"], "nothing"),
        (["--params", "nothing"], "nothing"),
    ],
)
def test_a_wrong_argument_is_one_clear_line(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert vobc.main(["tune", *words]) == 2

    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert said in lines[0]


def test_a_file_is_never_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.toml").write_text("mine", encoding="utf-8")

    assert vobc.main(["tune", "--out", str(tmp_path / "mine.toml")]) == 2
    assert "nothing is overwritten" in capsys.readouterr().err


def test_a_law_without_a_tuning_table_is_reported() -> None:
    with pytest.raises(SettingsError, match="--law nothing"):
        chosen_parameters("nothing", ())
    with pytest.raises(SettingsError, match="it has no tunable parameters"):
        chosen_parameters("chasing_literal", ())


@pytest.mark.parametrize("ends_after", [None, 20])
def test_the_command_writes_a_readable_file(
    ends_after: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This includes a run ended by Ctrl-C, which writes the best settings so far."""

    @contextmanager
    def crew(workers: int, files: object) -> Iterator[Bench]:
        yield Bench(BEST, ends_after=ends_after)

    monkeypatch.setattr(command, "local_crew", crew)
    out = tmp_path / "new" / "tuned.toml"

    code = vobc.main(["tune", "--budget", "60", "--parameters", *KEYS, "--out", str(out)])

    assert code == (0 if ends_after is None else 130)
    assert ("ended early" in out.read_text(encoding="utf-8")) == (code == 130)
    assert load_config(str(out)).ato.strategy == "pid"


def test_a_run_of_the_training_stops_on_the_bench() -> None:
    """A training run is a run like any other."""
    case = GROUND.training({KEYS[0]: 0.3}, 1)[1]

    result = run_case(case)

    assert result.measures["arrived_count"] == 1.0
    assert cost_cm([result], None, notches=False) < 20.0
