"""The files of a campaign's report agree with its results, whatever the names and the order."""

import dataclasses
import json
import math
import random
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as Tree

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy

from metro_hil.model.case import (
    Case,
    CaseEvent,
    CaseResult,
    ExpectedFailure,
    Host,
    MonitorResult,
    Setup,
    Verdict,
)
from metro_hil.report.campaign import write_reports
from metro_hil.report.campaign.parquet import column_of

HOSTILE: Final = """</script><img src=x onerror=alert(1)>"'&{{ 7*7 }}|`\x01\ufffe"""
VOID: Final = frozenset({"meta", "img", "br", "input", "hr", "link"})


def write(folder: Path, made: Any) -> dict[str, bytes]:
    folder.mkdir(exist_ok=True)
    paths = write_reports(folder, made.info, made.cases, made.results)
    return {path.name: path.read_bytes() for path in paths}


def with_verdict(made: Any, verdicts: dict[int, Verdict]) -> Any:
    results = [
        msgspec.structs.replace(r, verdict=verdicts[r.index], reason="said so")
        if r.index in verdicts
        else r
        for r in made.results
    ]
    return dataclasses.replace(made, results=results)


def junit_of(document: bytes) -> Tree.Element:
    """The document comes from this project, so it needs no protection against hostile XML."""
    return Tree.fromstring(document)  # noqa: S314


class Balance(HTMLParser):
    """Checks that tags are closed in order, and gathers text and tags."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def parsed(page: bytes) -> Balance:
    balance = Balance()
    balance.feed(page.decode())
    assert balance.open == []
    return balance


def test_the_summary_holds_figures_computed_independently(
    campaign: Callable[..., Any], tmp_path: Path
) -> None:
    made = campaign(210)

    summary = json.loads(write(tmp_path, made)["summary.json"])

    good = [r for r in made.results if r.verdict is Verdict.PASS]
    assert 0 < len(good) < 210
    assert summary["totals"]["as_expected"] == len(good)
    assert summary["totals"]["counts"]["fail"] == 210 - len(good)
    # Clopper–Pearson by its definition with the beta distribution.
    share = summary["totals"]["as_expected_share"]
    k, n = len(good), 210
    assert share["low"] == pytest.approx(scipy.stats.beta.ppf(0.025, k, n - k + 1), rel=1e-5)
    assert share["high"] == pytest.approx(scipy.stats.beta.ppf(0.975, k + 1, n - k), rel=1e-5)
    stop = next(m for m in summary["monitors"] if m["name"] == "stops within 10 cm")
    margins = [0.10 - r.measures["stop_error_worst_m"] for r in made.results]
    assert stop["margin_least"]["margin"] == pytest.approx(min(margins), rel=1e-5)
    worst = made.cases[int(np.argmin(margins))]
    assert stop["margin_least"]["case_id"] == worst.id
    assert stop["failed"] == sum(margin < 0.0 for margin in margins)
    mean = summary["measures"]["stop_I_error_m"]["mean"]
    values = np.array([r.measures["stop_I_error_m"] for r in made.results])
    assert mean["best"] == pytest.approx(values.mean(), rel=1e-5)
    half = 1.96 * values.std(ddof=1) / math.sqrt(len(values))
    assert mean["high"] - mean["low"] == pytest.approx(2.0 * half, rel=0.1)


def test_a_share_of_all_or_none_never_claims_certainty(
    campaign: Callable[..., Any], tmp_path: Path
) -> None:
    made = campaign(12)
    results = [msgspec.structs.replace(r, verdict=Verdict.PASS) for r in made.results]

    summary = json.loads(
        write(tmp_path, dataclasses.replace(made, results=results))["summary.json"]
    )

    share = summary["totals"]["as_expected_share"]
    assert share["best"] == share["high"] == 1.0
    assert share["low"] == pytest.approx(0.025 ** (1 / 12), rel=1e-5)


def test_order_host_and_time_of_arrival_change_no_byte(
    campaign: Callable[..., Any], tmp_path: Path
) -> None:
    """The test varies what differs between a resumed and an uninterrupted campaign."""
    made = campaign(63)
    cases, results = list(made.cases), list(made.results)
    random.Random(3).shuffle(cases)
    random.Random(4).shuffle(results)
    results = [
        msgspec.structs.replace(r, host=Host(wall_s=9.0, worker=f"w{n % 3}", attempts=1 + n % 2))
        for n, r in enumerate(results)
    ]
    lost = msgspec.structs.replace(results[0], verdict=Verdict.LOST, chain="", monitors=())

    through = write(tmp_path / "a", made)
    resumed = write(
        tmp_path / "b",
        dataclasses.replace(made, cases=cases, results=[results[1], lost, *results]),
    )

    assert through == resumed


def test_a_missing_case_makes_everything_red(campaign: Callable[..., Any], tmp_path: Path) -> None:
    made = campaign(21)
    passed = [msgspec.structs.replace(r, verdict=Verdict.PASS) for r in made.results]
    green = dataclasses.replace(made, results=passed)
    red = dataclasses.replace(made, results=passed[:-1])

    files, all_there = write(tmp_path / "red", red), write(tmp_path / "green", green)

    assert b"verdict good" in all_there["report.html"]
    assert b"verdict bad" in files["report.html"]
    assert b"1 case has no result" in files["report.html"]
    summary = json.loads(files["summary.json"])
    assert not summary["passed"]
    assert summary["totals"]["counts"]["missing"] == 1
    suites = junit_of(files["junit.xml"])
    assert suites.get("errors") == "1"
    assert [e.get("type") for e in suites.iter("error")] == ["missing"]


def test_cases_counted_by_the_manifest_but_not_named_are_missing(
    campaign: Callable[..., Any], tmp_path: Path
) -> None:
    made = campaign(21)
    made = dataclasses.replace(made, info=dataclasses.replace(made.info, expected_cases=23))

    files = write(tmp_path, made)

    assert b"2 cases have no result" in files["report.html"]
    assert junit_of(files["junit.xml"]).findall("testsuite")[-1].get("errors") == "1"
    assert json.loads(files["summary.json"])["totals"]["counts"]["missing"] == 2


def test_a_campaign_without_a_run_is_not_good(campaign: Callable[..., Any], tmp_path: Path) -> None:
    made = campaign(3)
    empty = dataclasses.replace(
        made, info=dataclasses.replace(made.info, expected_cases=0), cases=[], results=[]
    )

    files = write(tmp_path, empty)

    assert b"Nothing was run" in files["report.html"]
    assert not json.loads(files["summary.json"])["passed"]


def test_two_different_results_of_one_case_in_virtual_time_are_no_pass(
    campaign: Callable[..., Any], tmp_path: Path
) -> None:
    made = campaign(3)
    passed = [msgspec.structs.replace(r, verdict=Verdict.PASS) for r in made.results]
    other = msgspec.structs.replace(passed[1], chain="another")

    one_way = write(tmp_path / "a", dataclasses.replace(made, results=[*passed, other]))
    other_way = write(tmp_path / "b", dataclasses.replace(made, results=[other, *passed]))

    assert one_way == other_way
    summary = json.loads(one_way["summary.json"])
    assert [row["verdict"] for row in summary["unexpected"]] == ["invalid"]


def test_a_result_without_a_case_is_never_green(
    campaign: Callable[..., Any], tmp_path: Path
) -> None:
    made = campaign(3)
    passed = [msgspec.structs.replace(r, verdict=Verdict.PASS) for r in made.results]
    stray = msgspec.structs.replace(passed[0], case_id="somebody/else")

    files = write(tmp_path, dataclasses.replace(made, results=[*passed, stray]))

    assert b"verdict bad" in files["report.html"]
    assert junit_of(files["junit.xml"]).get("errors") == "1"


@pytest.mark.parametrize(
    ("verdict", "element"),
    [
        (Verdict.FAIL, "failure"),
        (Verdict.BLOCKED, "error"),
        (Verdict.INCONCLUSIVE, "error"),
        (Verdict.INVALID, "error"),
        (Verdict.LOST, "error"),
    ],
)
def test_junit_is_green_only_for_passes(
    verdict: Verdict, element: str, campaign: Callable[..., Any], tmp_path: Path
) -> None:
    made = campaign(7)
    made = with_verdict(made, dict.fromkeys(range(7), Verdict.PASS) | {4: verdict})

    suites = junit_of(write(tmp_path, made)["junit.xml"])

    found = [case for case in suites.iter("testcase") if case.find(element) is not None]
    assert [case.get("name") for case in found] == [made.cases[4].id]
    outcome = found[0].find(element)
    assert outcome is not None
    assert outcome.get("type") == verdict.value
    assert suites.get("skipped") == "0"


def test_junit_has_the_common_structure(campaign: Callable[..., Any], tmp_path: Path) -> None:
    """The common schema of Jenkins, GitLab and xunit: elements, order, attributes and counts."""
    made = campaign(42)

    suites = junit_of(write(tmp_path, made)["junit.xml"])

    assert suites.tag == "testsuites"
    assert [s.get("name") for s in suites] == ["table-8", "table-9", "night"]
    for suite in suites:
        cases = suite.findall("testcase")
        assert [child.tag for child in suite] == ["properties", *["testcase"] * len(cases)]
        assert int(suite.get("tests", "")) == len(cases)
        assert int(suite.get("failures", "")) == len(suite.findall("testcase/failure"))
        assert float(suite.get("time", "")) == pytest.approx(
            sum(float(case.get("time", "")) for case in cases)
        )
        for case in cases:
            assert set(case.attrib) == {"classname", "name", "time"}
            order = [child.tag for child in case]
            assert order == [t for t in ("properties", "failure", "error", "system-out")
                             if t in order]  # fmt: skip
    assert int(suites.get("tests", "")) == 42
    first = suites[0].find("testcase")
    assert first is not None
    facts = [(p.get("name"), p.get("value")) for p in first.iter("property")]
    assert ("requirement", "ACC-02") in facts
    assert ("requirement", "INV-04") in facts
    assert ("requirement", "INV-08") not in facts, "a monitor not exercised is no evidence"
    assert ("seed", "1") in facts
    assert ("chain", "0" * 16) in facts


MEANT = (ExpectedFailure(monitor="stops within 10 cm"),)


def test_an_expected_failure_passes_with_a_note(
    campaign: Callable[..., Any], tmp_path: Path
) -> None:
    made = with_verdict(campaign(3), {0: Verdict.FAIL, 1: Verdict.PASS, 2: Verdict.PASS})
    stop, *others = made.results[0].monitors
    failed = msgspec.structs.replace(stop, verdict=Verdict.FAIL, margin=-0.02)
    first = msgspec.structs.replace(made.results[0], monitors=(failed, *others))
    made = dataclasses.replace(made, results=[first, *made.results[1:]])
    cases = [
        msgspec.structs.replace(case, expected=MEANT) if case.index < 2 else case
        for case in made.cases
    ]

    suites = junit_of(write(tmp_path, dataclasses.replace(made, cases=cases))["junit.xml"])

    as_expected, not_as_expected, _ = suites.iter("testcase")
    assert as_expected.find("failure") is None
    assert as_expected.find("error") is None
    assert "as_expected" in {p.get("name") for p in as_expected.iter("property")}
    facts = [(p.get("name"), p.get("value")) for p in as_expected.iter("property")]
    assert ("requirement_known_not_met", "ACC-02") in facts
    assert ("requirement", "ACC-02") not in facts, "a known failure must not look like a proof"
    assert not_as_expected.find("error") is not None, "it passed where it should have failed"


@pytest.mark.parametrize("verdict", [Verdict.LOST, Verdict.INVALID])
def test_a_vacuous_result_cannot_be_expected(
    verdict: Verdict, campaign: Callable[..., Any], tmp_path: Path
) -> None:
    made = with_verdict(campaign(1, scenario_count=1), {0: verdict})
    cases = [msgspec.structs.replace(made.cases[0], expected=MEANT)]

    summary = json.loads(write(tmp_path, dataclasses.replace(made, cases=cases))["summary.json"])

    assert not summary["passed"]


def hostile() -> tuple[list[Case], list[CaseResult]]:
    case = Case(
        id=f"x/{HOSTILE}",
        index=0,
        scenario=HOSTILE,
        seed=1,
        setup=Setup(),
        factors={HOSTILE: HOSTILE, "b": [1, "<b>"]},
        requirements=(HOSTILE,),
    )
    monitor = MonitorResult(
        name=HOSTILE,
        verdict=Verdict.FAIL,
        margin=-0.25,
        unit=HOSTILE,
        at_s=1.0,
        detail=HOSTILE,
        requirements=(HOSTILE,),
    )
    result = CaseResult(
        case_id=case.id,
        index=0,
        verdict=Verdict.FAIL,
        reason=HOSTILE,
        monitors=(monitor,),
        measures={HOSTILE: 1.0, "fine_m": math.inf, "none_m": None},
        events=(CaseEvent(0.5, HOSTILE),),
    )
    return [case, msgspec.structs.replace(case, id="y", index=1, factors={HOSTILE: "z"})], [
        result,
        msgspec.structs.replace(result, case_id="y", index=1, measures={HOSTILE: 2.0}),
    ]


def test_hostile_names_are_shown_as_text(
    about: Callable[..., Any], campaign: Callable[..., Any], tmp_path: Path
) -> None:
    cases, results = hostile()
    info = dataclasses.replace(
        about(cases),
        **dict.fromkeys(("name", "title", "description", "bench", "controller"), HOSTILE),
        versions={HOSTILE: HOSTILE},
    )
    made = dataclasses.replace(campaign(1), info=info, cases=cases, results=results)

    files = write(tmp_path, made)

    page = parsed(files["report.html"])
    assert [tag for tag, _ in page.tags if tag in ("img", "b", "iframe")].count("img") == 0
    assert sum(tag == "script" for tag, _ in page.tags) == 1
    assert not any(name.startswith("on") for _, attributes in page.tags for name in attributes)
    assert any("onerror=alert(1)" in words for words in page.words)
    suites = junit_of(files["junit.xml"])
    assert suites.get("failures") == "2"
    table = pq.read_table(tmp_path / "measures.parquet")
    assert table.column("case_id").to_pylist() == [case.id for case in cases]
    markdown = files["requirements.md"].decode()
    assert "<img" not in markdown.replace("\\<img", "")
    assert json.loads(files["summary.json"])["totals"]["done"] == 2


def test_the_page_needs_no_network(campaign: Callable[..., Any], tmp_path: Path) -> None:
    page = parsed(write(tmp_path, campaign(63))["report.html"])

    links = [
        value
        for _, attributes in page.tags
        for name, value in attributes.items()
        if name in ("href", "src") and value
    ]
    here = {"summary.json", "measures.parquet", "junit.xml", "requirements.md"}
    assert [link for link in links if not link.startswith("#")]
    assert {link for link in links if not link.startswith("#")} <= here
    anchors = {attributes.get("id") for _, attributes in page.tags}
    assert {link[1:] for link in links if link.startswith("#")} <= anchors


def test_links_lead_to_the_exact_frames_of_a_kept_run(
    campaign: Callable[..., Any], keep_logs: Callable[[Path, Case], None], tmp_path: Path
) -> None:
    made = campaign(63)
    worst = min(made.results, key=lambda r: r.monitors[0].margin)
    keep_logs(tmp_path, made.cases[worst.index])

    page = write(tmp_path, made)["report.html"].decode()

    found = re.search(r'<a href="([^"]*bus\.log)">[^<]*</a>, frames (\d+)–(\d+)', page)
    assert found is not None
    log = (tmp_path / found[1]).read_text().splitlines()
    at_s = worst.monitors[0].at_s
    stamps = [float(line[1:].split(")")[0]) for line in log]
    inside = [n for n, t in enumerate(stamps, start=1) if at_s - 1.0 <= t <= at_s + 0.5]
    assert (int(found[2]), int(found[3])) == (inside[0], inside[-1])
    assert f"hil rerun . {worst.case_id}" in page
    assert "true speed" in page


def test_the_page_of_ten_thousand_cases_stays_small_and_names_what_is_left_out(
    campaign: Callable[..., Any], tmp_path: Path
) -> None:
    made = campaign(10_000)
    failed = sum(r.verdict is Verdict.FAIL for r in made.results)

    page = write(tmp_path, made)["report.html"]

    assert len(page) < 2_000_000
    assert failed > 100
    assert f"The first 100 of {failed}; {failed - 100} more are in" in page.decode()
    parsed(page)


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (pa.string(), ["a", None, "", "ä\0"]),
        (pa.float64(), [None, 1.5, math.nan, -0.0]),
        (pa.int64(), [2**63 - 1, None, -(2**63)]),
        (pa.bool_(), [True, None, False] * 5),
        (pa.string(), []),
        (pa.bool_(), [None, None]),
    ],
)
def test_a_column_and_its_gaps_are_those_of_pyarrow(kind: Any, values: list[Any]) -> None:
    names = {
        pa.string(): "text",
        pa.float64(): "number",
        pa.int64(): "whole",
        pa.bool_(): "flag",
    }

    column = column_of(names[kind], values)

    assert column.type == kind
    assert str(column) == str(pa.array(values, kind))
    column.validate(full=True)


def test_measures_come_back_from_parquet_with_their_units(
    campaign: Callable[..., Any], tmp_path: Path
) -> None:
    made = campaign(42)

    write(tmp_path, dataclasses.replace(made, results=made.results[:-1]))

    table = pq.read_table(tmp_path / "measures.parquet")
    assert table.num_rows == 42
    wanted = [r.measures["stop_II_error_m"] for r in made.results[:-1]]
    assert table.column("measure.stop_II_error_m").to_pylist() == [*wanted, None]
    assert table.schema.field("measure.stop_II_error_m").metadata == {b"unit": b"m"}
    assert table.schema.field("measure.run_time_s").metadata == {b"unit": b"s"}
    assert table.column("verdict").to_pylist()[-1] == "missing"
    errors = [case.factors["train.odometer_error"] for case in made.cases]
    assert table.column("factor.train.odometer_error").to_pylist() == errors
    margin = table.column("monitor.stops within 10 cm.margin").to_pylist()
    assert margin[:-1] == [r.monitors[0].margin for r in made.results[:-1]]
    assert table.column("chain").to_pylist()[:-1] == [r.chain for r in made.results[:-1]]
    assert not [name for name in table.column_names if "wall" in name or "worker" in name]


def test_a_satisfied_count_makes_no_case_the_worst(
    campaign: Callable[..., Any], tmp_path: Path
) -> None:
    """The margin of a count is always zero; the case of another monitor comes closest to a
    violation."""
    made = campaign(42)
    count = MonitorResult(name="no stop missed", verdict=Verdict.PASS, margin=0.0, unit="")
    results = [
        msgspec.structs.replace(r, verdict=Verdict.PASS, monitors=(count, *r.monitors))
        for r in made.results
    ]

    page = write(tmp_path, dataclasses.replace(made, results=results))["report.html"].decode()

    least = min(made.results, key=lambda r: r.monitors[0].margin)
    worst = page[page.index('id="worst"') : page.index('id="failures"')]
    assert re.findall(r"hil rerun \. (\S+?)<", worst)[0] == least.case_id
    assert "no stop missed" not in worst
