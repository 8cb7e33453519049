"""The board of lines and trains against handmade results, and the folders that it adds."""

from pathlib import Path

import pytest

from firmware_py.settings import SettingsError
from metro_hil.campaign.imported import imported_scenarios
from metro_hil.campaign.scenarios import read_named
from metro_hil.cli.hil import main
from metro_hil.engine.folder import CampaignPlan, make_folder
from metro_hil.model.case import Case, CaseResult, MonitorResult, Setup, Verdict
from metro_hil.report.layouts.lines import MARGIN, lines_tables
from metro_hil.report.layouts.lines_maps import draw_maps

TRAIN = {"Train.toml": "[brake]\n", "Train_params.toml": "[atp]\n"}


def case(index: int, line: str) -> Case:
    setup = Setup(line=line, consist="Train.toml")
    return Case(id=f"{line}/s{index}", index=index, scenario=line, seed=index, setup=setup)


def result(of: Case, margin_mps: float, **measures: float | None) -> CaseResult:
    verdict = Verdict.PASS
    monitor = MonitorResult(name=MARGIN, verdict=verdict, margin=margin_mps, unit="m/s")
    return CaseResult(
        case_id=of.id, index=of.index, verdict=verdict, monitors=(monitor,), measures=measures
    )


def test_a_row_joins_the_runs_of_a_line_and_a_train() -> None:
    one, two, three = case(1, "Far.toml"), case(2, "Far.toml"), case(3, "near")
    ran = result(
        one,
        1.0,
        stops_made_count=4.0,
        stops_missed_count=0.0,
        stop_error_mean_m=0.01,
        stop_error_worst_m=0.02,
        jerk_max_mps3=0.5,
        stop_A_run_s=60.0,
        stop_B_run_s=40.0,
        over_fastest_total_ratio=0.1,
        energy_drawn_kwh=30.0,
        energy_returned_kwh=10.0,
        distance_m=4000.0,
    )
    missed = result(
        two,
        0.5,
        stops_made_count=3.0,
        stops_missed_count=1.0,
        stop_error_worst_m=0.03,
        stop_A_run_s=80.0,
        doors_shut_count=1.0,
        stranded_count=0.0,
        stop_B_run_s=None,
        over_fastest_total_ratio=None,
    )

    (table,) = lines_tables([(one, ran), (two, missed), (three, None)])

    assert [[cell.text for cell in row] for row in table.rows] == [
        ["Far", "Train", "7/8", "1", "0", "1.0", "3.0", "0.50", "90", "10.0", "1.8", "5.0"],
        ["near", "Train", *["–"] * 10],
    ]


def test_lines_of_a_folder_run_with_its_train(tmp_path: Path) -> None:
    for name, text in {**TRAIN, "B.toml": "stations = []", "A.toml": "stations = []"}.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "own.toml").write_text("[[scenario]]\n[train]\n")

    scenarios = imported_scenarios(str(tmp_path))

    assert [each["name"] for each in scenarios] == ["A-Train", "B-Train"]
    assert {each["train"]["params"] for each in scenarios} == {str(tmp_path / "Train_params.toml")}


def test_each_route_of_an_imported_network_runs(tmp_path: Path) -> None:
    routes = "tracks = []\nroutes = [{name = 'a-b', legs = []}, {name = 'b-a', legs = []}]\n"
    for name, text in {**TRAIN, "Net.toml": routes}.items():
        (tmp_path / name).write_text(text)

    scenarios = imported_scenarios(str(tmp_path))

    assert [each["name"] for each in scenarios] == ["Net-a-b-Train", "Net-b-a-Train"]
    assert scenarios[0]["train"]["line"] == f"{tmp_path / 'Net.toml'}:a-b"


def test_added_scenarios_inherit_the_monitors_of_the_board() -> None:
    added = [{"name": "again", "train": {"line": "florence", "end": "II"}}]

    campaign = read_named("lines", added=added)

    again = campaign.scenarios[-1]
    assert (again.name, campaign.layout) == ("again", "lines")
    assert MARGIN in [table["name"] for table in again.points[0].monitors]


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({}, "holds no line file"),
        ({"A.toml": "stations = []", "T.toml": "[brake]\n"}, "T.toml has no params beside it"),
        (
            {"A.toml": "stations = []", **TRAIN, "U.toml": "[brake]\n"},
            "Train.toml, U.toml: more than one file of kind consist",
        ),
        ({"A.toml": "stations ="}, "A.toml"),
    ],
)
def test_an_unclear_folder_is_refused(files: dict[str, str], message: str, tmp_path: Path) -> None:
    for name, text in files.items():
        (tmp_path / name).write_text(text)

    with pytest.raises(SettingsError) as caught:
        imported_scenarios(str(tmp_path))

    assert message in str(caught.value)


def test_folders_are_for_the_board_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "smoke", "--with", str(tmp_path)]) == 2
    assert "only for `hil run lines`, not for smoke" in capsys.readouterr().err
    assert main(["run", "lines", "--with", str(tmp_path / "none")]) == 2
    assert "none: is not a folder" in capsys.readouterr().err


def test_each_line_has_a_map_even_one_whose_file_the_campaign_keeps(tmp_path: Path) -> None:
    kept = "name = 'kept'\nstart_m = 0\nend_m = 900\nspeed_sections = [{start_m = 0, end_m = 900, "
    kept += "limit_mps = 10}]\nstations = [{name = 'A', stop_m = 100, platform_start_m = 10, "
    kept += "platform_end_m = 110}]\n"
    cases = [case(0, "florence"), case(1, "florence"), case(2, "Far.toml")]
    plan = CampaignPlan(name="board", cases=cases, files={"Far.toml": kept}, options={})
    folder = make_folder(plan, str(tmp_path / "board"))

    figures = draw_maps(folder.path, cases)

    assert [figure.caption for figure in figures] == [
        "florence: 5 stations on 4.5 km",
        "kept: 1 stations on 0.0 km",
    ]
    for figure in figures:
        assert figure.path.read_bytes().startswith(b"\x89PNG")
