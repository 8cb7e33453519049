"""The search for the worst case, on margins that are cheap formulas."""

import statistics
import tomllib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import pytest

from metro_hil.campaign import CampaignError, define, plan_cases, read_campaign, read_definition
from metro_hil.model.case import Case, CaseResult, MonitorResult, Verdict
from metro_hil.search import SearchError, SearchSpace, Sought, WorstCaseSearch
from metro_hil.search.leave import append_history, write_worst
from metro_hil.search.objective import NOTHING_SEEN
from metro_hil.search.space import space_of

MIXED: Final = """
[[fault]]
kind = "brake_late"
[sweep]
[sweep.factors]
"train.load_ratio" = { low = 0.0, high = 1.0, count = 3 }
"train.odometer_error" = { low = -0.05, high = 0.05, count = 3 }
"fault.0.kind" = ["brake_late", "emergency_late", "holding_late"]
"fault.0.delay_s" = { low = 0, high = 10, step = 1 }
"""
Margin = Callable[[Case], dict[str, float | None]]


def space_from(text: str = MIXED, **chosen: Any) -> SearchSpace:
    return space_of(define(tomllib.loads(text), source="x.toml", name="x"), **chosen)


def result_of(case: Case, margins: dict[str, float | None]) -> CaseResult:
    failed = any(margin is not None and margin < 0.0 for margin in margins.values())
    return CaseResult(
        case_id=case.id,
        index=case.index,
        verdict=Verdict.FAIL if failed else Verdict.PASS,
        monitors=tuple(
            MonitorResult(name=name, verdict=Verdict.PASS, margin=margin, unit="m")
            for name, margin in margins.items()
        ),
    )


class Bench:
    """Replaces the simulation and counts its runs."""

    def __init__(self, margins: Margin) -> None:
        self._margins = margins
        self.runs = 0

    def __call__(self, cases: Sequence[Case]) -> Sequence[CaseResult]:
        self.runs += len(cases)
        return [result_of(case, self._margins(case)) for case in cases]


def valley(case: Case) -> dict[str, float | None]:
    """The minimum, -0.3, is at one kind of fault, one delay, one load and one odometer error."""
    setup, fault = case.setup, case.faults[0]
    assert setup.load_ratio is not None
    assert setup.odometer_error is not None
    kind = {"brake_late": 0.5, "emergency_late": 0.0, "holding_late": 0.8}[fault["kind"]]
    load = abs(setup.load_ratio - 0.77) * 2.0
    odometer = (setup.odometer_error * 20.0 + 0.3) ** 2
    return {"stop": kind + load + odometer + 0.1 * abs(fault["delay_s"] - 7) - 0.3}


def least(method: str, seed: int, budget: int = 200) -> float:
    bench = Bench(valley)
    search = WorstCaseSearch(
        space_from(), bench, monitor="stop", budget=budget, seed=seed, method=method
    )
    search.run()
    assert bench.runs == len(search.history) <= budget
    return search.worst(1)[0].value


def test_the_search_finds_lower_margins_than_random_sampling_with_the_same_budget() -> None:
    seeds = range(1, 6)

    sought = [least("cma", seed) for seed in seeds]
    by_chance = [least("random", seed) for seed in seeds]

    assert statistics.median(sought) < -0.2
    assert statistics.median(sought) < statistics.median(by_chance) - 0.1
    assert sum(a < b for a, b in zip(sought, by_chance, strict=True)) >= 4


def test_the_same_seed_finds_the_same_on_any_number_of_workers() -> None:
    def histories(evaluate: Callable[[Sequence[Case]], Sequence[CaseResult]]) -> list[Sought]:
        np.random.seed()
        return WorstCaseSearch(space_from(), evaluate, monitor="stop", budget=80, seed=4).run()

    def one(case: Case) -> CaseResult:
        return result_of(case, valley(case))

    with ThreadPoolExecutor(3) as pool:
        spread = histories(lambda cases: list(pool.map(one, cases)))

    assert spread == histories(Bench(valley))
    assert spread == histories(Bench(valley))
    assert (
        spread
        != WorstCaseSearch(space_from(), Bench(valley), monitor="stop", budget=80, seed=5).run()
    )


def test_runs_stay_within_the_space_and_never_repeat() -> None:
    history = WorstCaseSearch(space_from(), Bench(valley), budget=150, seed=2).run()

    points = [tuple(sought.values.items()) for sought in history]
    assert len(points) == len(set(points)) == 150
    assert [sought.number for sought in history] == list(range(150))
    for sought in history:
        values = sought.values
        assert 0.0 <= values["train.load_ratio"] <= 1.0
        assert -0.05 <= values["train.odometer_error"] <= 0.05
        assert values["fault.0.delay_s"] in range(11)
        assert isinstance(values["fault.0.delay_s"], int)


def test_a_small_space_is_searched_to_its_end() -> None:
    text = '[sweep.factors]\n"train.load_ratio" = [0.0, 0.5, 1.0]\n"train.end" = ["I", "II"]\n'
    bench = Bench(lambda case: {"m": case.setup.load_ratio})

    search = WorstCaseSearch(space_from(text), bench, budget=100)
    search.run()

    assert bench.runs == 6
    assert search.worst(1)[0].values["train.load_ratio"] == 0.0


def test_only_the_chosen_factors_vary() -> None:
    text = (
        '[train]\nload_ratio = 0.25\n[sweep.factors]\n"train.load_ratio" = [0.0, 1.0]\n'
        '"train.odometer_error" = { low = 0.0, high = 0.1 }\n[sweep]\ndesign = "lhs"\ncount = 3\n'
    )
    seen: list[float | None] = []

    def margins(case: Case) -> dict[str, float | None]:
        seen.append(case.setup.load_ratio)
        return {"m": case.setup.odometer_error}

    WorstCaseSearch(
        space_from(text, keys=["train.odometer_error"]), Bench(margins), budget=16
    ).run()

    assert seen == [0.25] * 16


def test_every_seed_is_run_and_the_worst_one_reported() -> None:
    text = (
        'seeds = [3, 8]\n[sweep.factors]\n"train.load_ratio" = { low = 0, high = 1, count = 2 }\n'
    )
    bench = Bench(lambda case: {"m": 1.0 if case.seed == 3 else 0.5})

    history = WorstCaseSearch(space_from(text), bench, budget=10).run()

    assert bench.runs == 10
    assert len(history) == 5
    assert {(sought.seed, sought.margins["m"]) for sought in history} == {(8, 0.5)}


def test_monitors_with_different_units_are_scaled_by_their_usual_size() -> None:
    """A margin of 100 kN that falls to a tenth is worse than one of 0.1 m that falls by a third."""
    text = '[sweep.factors]\n"train.load_ratio" = { low = 0.0, high = 1.0, count = 2 }\n'

    def margins(case: Case) -> dict[str, float | None]:
        load = case.setup.load_ratio
        assert load is not None
        return {"force": 1.0e5 * (1.0 - 0.9 * load), "gap": 0.1 * (1.0 + 0.5 * load)}

    search = WorstCaseSearch(space_from(text), Bench(margins), budget=100)
    search.run()

    assert search.worst(1)[0].values["train.load_ratio"] > 0.95


def test_inconclusive_runs_are_no_finds() -> None:
    text = '[sweep.factors]\n"train.load_ratio" = { low = 0.0, high = 1.0, count = 2 }\n'

    def margins(case: Case) -> dict[str, float | None]:
        load = case.setup.load_ratio
        assert load is not None
        return {"m": None if load < 0.5 else load}

    search = WorstCaseSearch(space_from(text), Bench(margins), monitor="m", budget=60)
    search.run()

    assert {sought.value for sought in search.history if not sought.margins} == {NOTHING_SEEN}
    assert 0.5 <= search.worst(1)[0].value < 0.55
    assert all(sought.margins for sought in search.worst(60))


def test_a_dead_controller_counts_as_a_violation() -> None:
    text = '[sweep.factors]\n"train.load_ratio" = { low = 0.0, high = 1.0, count = 2 }\n'

    def evaluate(cases: Sequence[Case]) -> Sequence[CaseResult]:
        return [
            msgspec.structs.replace(
                result_of(case, {"m": 5.0}),
                verdict=Verdict.FAIL if (case.setup.load_ratio or 0.0) > 0.9 else Verdict.PASS,
            )
            for case in cases
        ]

    search = WorstCaseSearch(space_from(text), evaluate, budget=40)
    search.run()

    assert search.worst(1)[0].value == -1.0
    assert search.worst(1)[0].verdict == "fail"


def test_combinations_that_the_schema_or_the_sweep_refuses_are_not_run() -> None:
    text = (
        '[sweep]\nexclude = ["load_ratio > 0.5"]\n[sweep.factors]\n'
        '"train.load_ratio" = { low = 0.0, high = 1.0, count = 5 }\n'
    )
    seen: list[float | None] = []

    def margins(case: Case) -> dict[str, float | None]:
        seen.append(case.setup.load_ratio)
        return {"m": 1.0}

    WorstCaseSearch(space_from(text), Bench(margins), budget=30).run()

    assert seen
    assert max(load or 0.0 for load in seen) <= 0.5


def test_the_runs_of_a_search_go_on_after_a_violation() -> None:
    def margins(case: Case) -> dict[str, float | None]:
        assert not case.stop_at_violation
        return valley(case)

    WorstCaseSearch(space_from(), Bench(margins), budget=8).run()


@pytest.mark.parametrize(
    ("chosen", "said"),
    [
        ({"scenario": "y"}, "--scenario y: .*x"),
        (
            {"keys": ["train.load"]},
            r"--factors train\.load: nearest valid factor: train\.load_ratio",
        ),
    ],
)
def test_a_wrong_option_gets_a_valid_suggestion(chosen: dict[str, Any], said: str) -> None:
    with pytest.raises(SearchError, match=said):
        space_from(**chosen)


def test_a_search_needs_a_sweep_and_an_existing_monitor() -> None:
    with pytest.raises(SearchError, match="nothing to vary"):
        space_from("")
    with pytest.raises(SearchError, match="--monitor stopp: nearest valid value: stop"):
        WorstCaseSearch(space_from(), Bench(valley), monitor="stopp", budget=8).run()


def test_the_worst_cases_are_written_as_a_repeatable_campaign(tmp_path: Path) -> None:
    source = tmp_path / "source"
    (source / "trains").mkdir(parents=True)
    consist = Path(str(next(iter(shipped_consists()))))
    (source / "trains" / "mine.toml").write_bytes(consist.read_bytes())
    (source / "c.toml").write_text(
        f'layout = "x"\ntrain = {{ consist = "trains/mine.toml" }}\nseeds = [4, 9]\n{MIXED}'
    )
    definition = read_definition(str(source / "c.toml"))
    space = space_of(definition)
    ran: dict[str, Case] = {}

    def margins(case: Case) -> dict[str, float | None]:
        ran[f"{case.id}"] = case
        return valley(case)

    search = WorstCaseSearch(space, Bench(margins), budget=80)
    search.run(lambda new: append_history(tmp_path, new))
    worst = search.worst(3)
    path = write_worst(tmp_path, space, worst, definition.campaign.files)

    campaign = read_campaign(str(path))
    repeated = plan_cases(campaign)
    assert [scenario.name for scenario in campaign.scenarios] == ["worst-1", "worst-2", "worst-3"]
    for sought, case in zip(worst, repeated, strict=True):
        first = ran[sought.case_id]
        assert (case.setup, case.faults, case.seed) == (first.setup, first.faults, first.seed)
        assert (case.monitors, case.invariants) == (first.monitors, first.invariants)
        assert case.stop_at_violation == first.stop_at_violation
    assert campaign.files == definition.campaign.files
    lines = (tmp_path / "history.jsonl").read_bytes().splitlines()
    assert [msgspec.json.decode(line, type=Sought) for line in lines] == search.history


def shipped_consists() -> list[Path]:
    import plant_emulator.consists as consists

    return sorted(Path(folder) / "florence4.toml" for folder in consists.__path__)


def test_a_broken_campaign_cannot_be_searched() -> None:
    with pytest.raises(CampaignError):
        space_from('[sweep.factors]\n"train.lod_ratio" = [1, 2]\n')
