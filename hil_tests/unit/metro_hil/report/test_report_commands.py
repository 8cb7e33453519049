"""`hil report` and `hil compare` on campaign folders as the engine leaves them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from metro_hil.cli.hil import main
from metro_hil.cli.hil.compare import compare_campaigns
from metro_hil.engine.folder import CampaignFolder, CampaignPlan, make_folder
from metro_hil.engine.journal import Journal, LostAttempt, Session
from metro_hil.model.case import Verdict


def left_behind(path: Path, made: Any, *, killed: bool = False) -> CampaignFolder:
    """A finished campaign; with `killed` it was resumed in between."""
    plan = CampaignPlan(
        name="made-up", title="Made up", cases=made.cases, files={}, options={}, layout="florence"
    )
    folder = make_folder(plan, str(path))
    journal = Journal(folder.journal_path, folder.head())
    results = list(made.results)
    try:
        if killed:
            results = results[::-1]
            journal.append(LostAttempt(results[3].case_id, 1, "its worker died"))
        for number, result in enumerate(results):
            if killed and number == 5:
                journal.append(Session("later", "program", "crew"))
                journal.append(results[4])
            journal.append(result)
    finally:
        journal.close()
    return folder


@pytest.mark.parametrize("words", [["show"], ["laws", "--run"], ["requirements", "--out"]])
def test_an_impossible_file_name_is_handled_by_the_frame_of_every_command(
    words: list[str],
) -> None:
    """`Program` turns the error into one line with exit code 3."""
    with pytest.raises(OSError, match="File name too long"):
        main([*words, "x" * 300])


@pytest.mark.parametrize("verb", ["run", "resume", "verify", "search", "simulate"])
def test_more_processes_than_a_machine_can_have_are_refused(
    verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main([verb, "x", "--workers", "1025"])

    assert ended.value.code == 2
    assert "argument --workers: 1025 is more than 1024" in capsys.readouterr().err


def test_a_campaign_killed_and_resumed_has_the_same_report_to_the_byte(
    campaign: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = campaign(42)
    through = left_behind(tmp_path / "a", made)
    resumed = left_behind(tmp_path / "b", made, killed=True)

    codes = [main(["report", str(folder.path), "--json"]) for folder in (through, resumed)]

    assert codes == [1, 1], "some of the made-up stops are too far off"
    said = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [len(one["reports"]) for one in said] == [5, 5]
    for one, other in zip(said[0]["reports"], said[1]["reports"], strict=True):
        assert Path(one).read_bytes() == Path(other).read_bytes()


def test_a_report_can_be_written_while_cases_are_missing(
    campaign: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = campaign(21)
    made.results.pop()
    folder = left_behind(tmp_path / "a", made)

    code = main(["report", str(folder.path)])

    assert code == 1
    assert "1 without a result" in capsys.readouterr().out


def test_an_invalid_folder_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    code = main(["report", "nowhere"])

    assert code == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_verdict_that_got_worse_fails_the_comparison(
    campaign: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = campaign(21)
    before = left_behind(tmp_path / "a", made)
    good = next(r for r in made.results if r.verdict is Verdict.PASS)
    made.results[good.index] = msgspec.structs.replace(
        good, verdict=Verdict.FAIL, reason="[bold]too far[/bold]", chain="f" * 16
    )
    after = left_behind(tmp_path / "b", made)

    same = main(["compare", str(before.path), str(before.path)])
    assert "No verdict got worse." in capsys.readouterr().out
    worse = main(["compare", str(before.path), str(after.path)])

    assert (same, worse) == (0, 1)
    said = capsys.readouterr().out
    assert "Verdicts that got worse: 1" in said
    assert "20 of them bit-identical" in " ".join(said.split())
    assert main(["compare", str(before.path), str(after.path), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert [change["case_id"] for change in document["worse"]] == [good.case_id]


def test_campaigns_without_a_common_case_do_not_pass(
    campaign: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = campaign(21)
    before = left_behind(tmp_path / "a", made)
    made.cases[:] = [
        msgspec.structs.replace(case, id=f"other/{case.index}", scenario="other")
        for case in made.cases
    ]
    made.results.clear()
    after = left_behind(tmp_path / "b", made)

    assert main(["compare", str(before.path), str(after.path)]) == 2
    assert "no case is in both" in capsys.readouterr().err


def test_a_measure_that_got_worse_fails_only_on_request(
    campaign: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = campaign(21)
    before = left_behind(tmp_path / "a", made)
    made.results[:] = [
        msgspec.structs.replace(
            r,
            measures={
                **r.measures,
                "stop_error_worst_m": r.measures["stop_error_worst_m"] * 1.01 + 1e-4,
            },
        )
        for r in made.results
    ]
    after = left_behind(tmp_path / "b", made)
    words = ["compare", str(before.path), str(after.path)]

    codes = [main(words), main([*words, "--fail-on-worse"])]

    assert codes == [0, 1]
    assert "worse" in capsys.readouterr().out
    worse = compare_campaigns(before.path, after.path).significantly_worse
    assert [shift.name for shift in worse] == ["stop_error_worst_m"]
    assert main(["compare", str(after.path), str(before.path), "--fail-on-worse"]) == 0
