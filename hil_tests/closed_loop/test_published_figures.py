"""The published figures of the control laws, and a picture, agree with the present code.

No case runs while the sources are unchanged since the measurement. Otherwise one case of each
shorter scenario, and of the tables in docs/results, must give the published digits.
"""

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec
import pytest

from metro_hil.cli.hil import laws, main
from metro_hil.cli.hil.laws import planned, published, run_cases
from metro_hil.engine.sources import sources_hash
from metro_hil.model.case import Case, CaseResult
from metro_hil.report.law_figures import Results, read_results, results_json
from metro_hil.report.standing import standings
from metro_tools import picture_doc

ROOT: Final = Path(__file__).resolve().parents[2]
SHORT_S: Final = 150.0
"""Longest run in virtual time that is checked here, s. `make docs` checks all scenarios.

A whole line takes several seconds to compute, a single hop about one.
"""
SHOWN: Final = ("table-7-predictive", "table-8-predictive", "table-9-predictive")
FIGURES: Final = published()


def is_checked(name: str, run_s: float | None) -> bool:
    short = run_s is not None and run_s <= SHORT_S
    return name in SHOWN or short


CHECKED: Final = [
    (law, name)
    for law, own in FIGURES.items()
    for name, each in own.items()
    if is_checked(name, each.figures.run_s)
]


def run_once(cases: Sequence[Case]) -> list[CaseResult]:
    """Run cases, or return the results of the same cases in an earlier test."""
    return list(results_of(msgspec.json.encode(list(cases))))


@functools.cache
def results_of(cases: bytes) -> list[CaseResult]:
    return run_cases(msgspec.json.decode(cases, type=list[Case]))


@pytest.mark.parametrize(("law", "name"), CHECKED, ids=[name for _, name in CHECKED])
def test_published_figures_agree_with_the_present_code(law: str, name: str) -> None:
    """When this fails, `make figures` measures again what a change of the controller affected."""
    one: Results = {law: {name: FIGURES[law][name]}}

    (standing,) = standings(one, sources_hash(), plan=planned, run=run_once, probes_max=1)

    assert standing.reason == ""


def test_every_shown_scenario_is_checked() -> None:
    assert set(SHOWN) <= {name for _, name in CHECKED}


def test_every_published_scenario_keeps_cases_to_compare_with() -> None:
    assert all(each.probes for own in FIGURES.values() for each in own.values())


def test_the_picture_of_a_reckless_driver_agrees_with_the_present_code() -> None:
    """`make docs` checks the other pictures."""
    assert picture_doc.main(["--check", "--root", str(ROOT), "protection"]) == 0


@pytest.mark.parametrize("published_m", [None, 0.1234])
def test_hil_laws_check_refuses_figures_that_the_code_does_not_give(
    published_m: float | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The figure comes from other sources: with the published digits it is current, with another
    digit it is stale."""
    figures = FIGURES["green"]["green-undervoltage"]
    (probe,) = figures.probes
    (stop,) = (name for name in probe.measures if name.startswith("stop_"))
    if published_m is not None:
        probe = msgspec.structs.replace(probe, measures={**probe.measures, stop: published_m})
    figures = msgspec.structs.replace(figures, sources="others", probes=(probe,))
    path = tmp_path / "law_results.json"
    path.write_text(results_json({"green": {"green-undervoltage": figures}}), encoding="utf-8")
    monkeypatch.setattr(laws, "kept", lambda: path)
    monkeypatch.setattr(laws, "run_cases", run_once)

    code = main(["laws", "--check", "--write"])

    said = capsys.readouterr()
    kept = read_results(path.read_text(encoding="utf-8"))["green"]["green-undervoltage"]
    if published_m is None:
        assert code == 0
        assert "green-undervoltage (green): current, same digits in 1 case run again" in said.out
        assert kept.sources == sources_hash()
    else:
        assert code == 1
        assert f"published was {published_m}; `make figures` measures it again" in said.err
        assert kept.sources == "others"
