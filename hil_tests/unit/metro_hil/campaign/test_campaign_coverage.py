"""Coverage of the space of a sweep, against counting by hand."""

import itertools
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from metro_hil.campaign.coverage import CONCLUSIVE, GAPS_MAX, coverage
from metro_hil.model.case import Case, CaseResult, MonitorResult, Setup, Verdict


def case_of(index: int, factors: dict[str, Any], scenario: str = "s") -> Case:
    return Case(
        id=f"{scenario}/{index}",
        index=index,
        scenario=scenario,
        seed=1,
        setup=Setup(),
        factors=factors,
    )


def result_of(case: Case, verdict: Verdict, margin_m: float | None = None) -> CaseResult:
    monitor = MonitorResult(name="m", verdict=Verdict.PASS, margin=margin_m, unit="m")
    return CaseResult(case_id=case.id, index=case.index, verdict=verdict, monitors=(monitor,))


rows = st.lists(
    st.tuples(
        st.sampled_from("abc"),
        st.integers(0, 2),
        st.booleans(),
        st.sampled_from([None, Verdict.PASS, Verdict.FAIL, Verdict.LOST, Verdict.BLOCKED]),
    ),
    min_size=1,
    max_size=30,
)


@given(rows, st.integers(1, 3))
def test_shares_agree_with_counting(
    drawn: list[tuple[str, int, bool, Verdict | None]], strength: int
) -> None:
    cases = [case_of(i, {"x": x, "y": y, "z": z}) for i, (x, y, z, _) in enumerate(drawn)]
    results = [
        result_of(case, row[3])
        for case, row in zip(cases, drawn, strict=True)
        if row[3] is not None
    ]

    (covered,) = coverage(cases, results, strength).scenarios

    share = covered.shares[-1]
    assert share.strength == strength
    combinations = run = conclusive = 0
    for columns in itertools.combinations(range(3), strength):
        spaces = [{row[column] for row in drawn} for column in columns]
        for spot in itertools.product(*spaces):
            verdicts = [row[3] for row in drawn if tuple(row[c] for c in columns) == spot]
            combinations += 1
            run += any(verdict is not None for verdict in verdicts)
            conclusive += any(verdict in CONCLUSIVE for verdict in verdicts)
    assert (share.combinations, share.run, share.conclusive) == (combinations, run, conclusive)
    assert share.gap_count == combinations - conclusive
    assert len(share.gaps) == min(GAPS_MAX, share.gap_count)


def test_a_gap_names_its_levels_and_whether_they_were_run() -> None:
    cases = [case_of(0, {"x": 1.0, "y": "a"}), case_of(1, {"x": 2.0, "y": "b"})]
    results = [result_of(cases[0], Verdict.PASS), result_of(cases[1], Verdict.INVALID)]

    (covered,) = coverage(cases, results).scenarios

    pairs = covered.shares[1]
    assert [(gap.bins, gap.ran) for gap in pairs.gaps] == [
        ({"x": "1", "y": "b"}, False),
        ({"x": "2", "y": "a"}, False),
        ({"x": "2", "y": "b"}, True),
    ]
    assert pairs.run_ratio == 0.5
    assert pairs.conclusive_ratio == 0.25


def test_many_numbers_are_grouped_in_bins_of_equal_width() -> None:
    cases = [case_of(i, {"x": i / 100.0}) for i in range(101)]
    results = [result_of(case, Verdict.PASS, 1.0 - case.factors["x"]) for case in cases]

    (covered,) = coverage(cases, results, bins=4).scenarios

    assert covered.axes[0].bins == ("0..0.25", "0.25..0.5", "0.5..0.75", "0.75..1")
    assert [cell.cases for cell in covered.singles] == [25, 25, 25, 26]
    assert covered.singles[-1].margins == {"m": 0.0}
    assert covered.singles[-1].worst == {"m": "s/100"}


def test_the_least_margin_of_each_pair_of_levels_is_reported() -> None:
    values = {
        ("a", 1): [0.5, 0.2],
        ("a", 2): [0.9, 0.8],
        ("b", 1): [-0.1, 0.4],
        ("b", 2): [0.3, 0.6],
    }
    cases, results = list[Case](), list[CaseResult]()
    for (x, y), margins_m in values.items():
        for margin_m in margins_m:
            case = case_of(len(cases), {"x": x, "y": y})
            cases.append(case)
            verdict = Verdict.FAIL if margin_m < 0.0 else Verdict.PASS
            results.append(result_of(case, verdict, margin_m))

    (covered,) = coverage(cases, results).scenarios

    found = {(cell.bins["x"], int(cell.bins["y"])): cell for cell in covered.pairs}
    assert {spot: cell.margins["m"] for spot, cell in found.items()} == {
        spot: min(margins_m) for spot, margins_m in values.items()
    }
    assert found[("b", 1)].failed == 1
    assert found[("b", 1)].worst == {"m": "s/4"}


def test_each_scenario_with_a_sweep_is_examined_separately() -> None:
    cases = [
        case_of(0, {"x": 1}, "one"),
        case_of(1, {"x": 2}, "two"),
        case_of(2, {}, "three"),
    ]

    covered = coverage(cases, [])

    assert [scenario.scenario for scenario in covered.scenarios] == ["one", "two"]
    assert covered.scenarios[0].shares[0].run == 0
    assert covered.scenarios[0].shares[0].gap_count == 1


def test_the_order_of_cases_and_results_changes_nothing() -> None:
    cases = [case_of(i, {"x": i % 3, "y": i % 4}) for i in range(9)]
    results = [result_of(case, Verdict.PASS, float(case.index % 5)) for case in cases]

    assert coverage(cases, results) == coverage(cases[::-1], results[3:] + results[:3])
