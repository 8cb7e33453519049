"""The table of stops over the envelope: its campaign, and the cells of a row."""

from importlib import resources
from pathlib import Path

import pytest

from metro_hil.benchmarks.stops import ENVELOPE, Row, campaign_text, cells, main
from metro_hil.campaign import plan_cases
from metro_hil.campaign.read import read_campaign
from metro_hil.model.case import Case, CaseResult, Verdict
from metro_hil.report.law_figures import law_of


def planned(tmp_path: Path, rows: tuple[Row, ...]) -> tuple[Case, ...]:
    with resources.as_file(resources.files("metro_hil") / "campaign/shipped/lines") as lines:
        path = tmp_path / "envelope.toml"
        path.write_text(campaign_text(rows, ["predictive", "pid"], 2, lines), encoding="utf-8")
        return plan_cases(read_campaign(str(path)))


def test_every_row_is_run_by_every_law_with_every_seed(tmp_path: Path) -> None:
    cases = planned(tmp_path, ENVELOPE)

    assert len(cases) == len(ENVELOPE) * 2 * 2
    assert {law_of(case) for case in cases} == {"predictive", "pid"}
    assert len({row.name for row in ENVELOPE}) == len(ENVELOPE)


def test_a_row_changes_the_real_train_and_not_what_the_controller_believes(tmp_path: Path) -> None:
    (weak,) = (row for row in ENVELOPE if row.name == "brake gain 0.75")
    case = planned(tmp_path, (weak,))[0]

    assert case.setup.real["brake.service.gain_ratio.high"] == 0.75
    assert set(case.setup.believed) == {"ato.strategy"}


def test_jogs_emergencies_and_missed_stops_are_counted(tmp_path: Path) -> None:
    pairs: list[tuple[Case, CaseResult | None]] = []
    cases = planned(tmp_path, (Row("as assumed"),))[:2]
    for number, (case, error_m) in enumerate(zip(cases, (0.04, -0.5), strict=True)):
        measures = {
            "stop_III_error_m": error_m,
            "jogs_count": 2.0,
            "emergency_count": 1.0,
            "doors_shut_count": float(number),
            "stranded_count": 2.0 * number,
        }
        result = CaseResult(
            case_id=case.id, index=number, verdict=Verdict.PASS, measures=dict(measures)
        )
        pairs.append((case, result))

    row = cells("as assumed", "pid", pairs)

    assert row[:5] == ("as assumed", "pid", "2/2", "27.0", "-50.0")
    assert row[6:11] == ("50", "4", "2", "1", "2")


def test_an_unknown_row_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["gradient"])

    assert "no row has gradient in its name" in capsys.readouterr().err
