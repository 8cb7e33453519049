"""`hil` on the command line: its output, its files, and its exit codes."""

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

import msgspec
import pytest

from firmware_py.clock.clock import NS_PER_S, WallClock
from metro_hil.cli.hil import main
from metro_hil.engine.folder import CampaignFolder, CampaignPlan, find_folder, folders, make_folder
from metro_hil.engine.journal import read_journal
from metro_hil.engine.trial_runner import trial_cases
from metro_hil.model.case import Case

RUNNER: Final = "metro_hil.engine.trial_runner:run_case"
GIVE_UP_S: Final = 60.0


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for this test alone, which holds runs/ for its campaigns."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def failing(cases: tuple[Case, ...], *indices: int) -> tuple[Case, ...]:
    changed = list(cases)
    for index in indices:
        setup = msgspec.structs.replace(cases[index].setup, real={"trial.verdict": "fail"})
        changed[index] = msgspec.structs.replace(cases[index], setup=setup)
    return tuple(changed)


def begun_campaign(cases: tuple[Case, ...] = trial_cases(4), name: str = "trial") -> CampaignFolder:
    """A campaign that is ready to be resumed."""
    options = {"runner": RUNNER, "no_report": True}
    return make_folder(CampaignPlan(name=name, cases=cases, files={}, options=options))


def said(capsys: pytest.CaptureFixture[str]) -> tuple[dict[str, Any], str]:
    output, errors = capsys.readouterr()
    return json.loads(output), errors


def test_a_passed_campaign_has_exit_code_0_and_prints_one_json_object(
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = begun_campaign()

    code = main(["resume", "--json"])

    document, errors = said(capsys)
    assert code == 0
    assert document["passed"] is True
    assert (document["cases"], document["done"], document["counts"]["pass"]) == (4, 4, 4)
    assert document["folder"] == str(folder.path)
    assert "passed" in errors


def test_a_failed_campaign_has_exit_code_1_and_names_the_case(
    capsys: pytest.CaptureFixture[str],
) -> None:
    begun_campaign(failing(trial_cases(4), 2))

    code = main(["resume", "--json"])

    document, errors = said(capsys)
    assert code == 1
    assert document["unexpected"] == ["trial/0002-s3"]
    assert "trial/0002-s3" in errors


def test_list_shows_the_state_of_each_campaign(capsys: pytest.CaptureFixture[str]) -> None:
    main(["resume", begun_campaign(name="good").path.name, "--json"])
    main(["resume", begun_campaign(failing(trial_cases(2), 0), "bad").path.name, "--json"])
    begun_campaign(name="new")
    capsys.readouterr()

    code = main(["list", "--json"])

    rows = said(capsys)[0]["campaigns"]
    assert code == 0
    assert {row["name"].split("_")[1]: row["state"] for row in rows} == {
        "good": "passed",
        "bad": "failed",
        "new": "unfinished",
    }


def test_show_prints_all_results_and_the_event_log_of_a_case(
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = begun_campaign(failing(trial_cases(4), 1))
    main(["resume", "--json"])
    capsys.readouterr()

    assert main(["show", "--json"]) == 1
    document, _ = said(capsys)
    assert [one["verdict"] for one in document["results"]] == ["pass", "fail", "pass", "pass"]

    assert main(["show", folder.path.name, "trial/0001"]) == 1
    story, _ = capsys.readouterr()
    assert "asked to fail" in story
    assert "bus.log" in story
    assert main(["show", folder.path.name, "trial/0002", "--json"]) == 0


def test_show_names_unexpected_results_with_their_reasons(
    capsys: pytest.CaptureFixture[str],
) -> None:
    begun_campaign(failing(trial_cases(4), 1))
    main(["resume", "--json"])
    capsys.readouterr()

    assert main(["show"]) == 1

    shown, _ = capsys.readouterr()
    assert "not as expected" in shown
    assert "trial/0001" in shown.partition("least margins")[0]
    assert "asked to fail" in shown


def test_rerun_repeats_the_first_failure_with_its_logs(capsys: pytest.CaptureFixture[str]) -> None:
    begun_campaign(failing(trial_cases(4), 2))
    main(["resume", "--json"])
    capsys.readouterr()

    code = main(["rerun", "--json"])

    document, _ = said(capsys)
    assert code == 1
    assert document["case"]["id"] == "trial/0002-s3"
    assert document["difference"] == ""
    assert any(path.endswith("bus.log") for path in document["logs"])


def test_rerun_accepts_campaign_and_case_in_one_argument_and_another_seed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = begun_campaign()
    main(["resume", "--json"])
    before = read_journal(folder.journal_path).results[1].chain
    capsys.readouterr()

    code = main(["rerun", f"{folder.path.name}/trial/0001-s2", "--seed", "77", "--json"])

    document, _ = said(capsys)
    assert code == 0
    assert document["case"]["seed"] == 77
    assert document["result"]["chain"] != before


def test_another_frame_hash_of_the_same_case_is_reported_loudly(
    capsys: pytest.CaptureFixture[str],
) -> None:
    (case,) = trial_cases(1)
    setup = msgspec.structs.replace(case.setup, real={"trial.fickle": True})
    begun_campaign((msgspec.structs.replace(case, setup=setup),))
    main(["resume", "--json", "--keep-worst", "0"])
    capsys.readouterr()

    code = main(["rerun", "--json"])

    document, errors = said(capsys)
    assert code == 1
    assert document["difference"].startswith("NOT DETERMINISTIC")
    assert "NOT DETERMINISTIC" in errors


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["run", "no-such-campaign"], "no-such-campaign"),
        (["run", "smoke", "--filter", "nothing"], "--filter nothing"),
        (["run", "smoke", "--controller", "mine"], "--controller mine"),
        (["run", "smoke", "--on", "spark://x:1"], "--on spark://x:1"),
        (["resume", "no-such-run"], "no-such-run"),
        (["resume", "--on", "spark://x:1"], "--on spark://x:1"),
        (["show", "no-such-run"], "no-such-run"),
        (["rerun", "no-such-run/case"], "no-such-run/case"),
    ],
    ids=lambda value: "-".join(value[:2]) if isinstance(value, list) else "",
)
def test_a_user_error_has_exit_code_2_and_one_line_that_names_it(
    words: list[str], what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if "--on" in words:
        begun_campaign()

    code = main(words)

    output, errors = capsys.readouterr()
    assert (code, output) == (2, "")
    assert what in errors
    assert len(errors.splitlines()) == 1


def test_without_any_campaign_the_message_tells_how_to_run_one(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["resume"]) == 2
    assert "hil run" in capsys.readouterr().err


def test_a_damaged_journal_gives_exit_code_3_until_the_campaign_is_resumed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = begun_campaign()
    main(["resume", "--json"])
    whole = folder.journal_path.read_bytes()
    folder.journal_path.write_bytes(whole.replace(b"trial/0001-s2", b"trial/0001-s9"))
    capsys.readouterr()

    codes = [main(["show"]), main(["report"]), main(["list", "--json"])]
    errors = capsys.readouterr().err
    healed = main(["resume", "--json"])

    assert codes == [3, 3, 0]
    assert "journal.jsonl: line" in errors
    assert healed == 0
    assert "1 damaged lines left out; their cases are run again" in capsys.readouterr().err
    assert len(read_journal(folder.journal_path).results) == 4


def test_a_changed_program_does_not_resume_without_consent(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    begun_campaign()
    main(["resume", "--json"])
    for module in ("program", "run_campaign", "folder"):
        monkeypatch.setattr(f"metro_hil.engine.{module}.program_version", lambda: "9.9.9+other")

    assert main(["resume"]) == 2
    assert "--despite-change" in capsys.readouterr().err


def test_a_campaign_run_by_two_programs_never_passes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = begun_campaign()
    main(["resume", "--json", "--fail-fast"])
    lines = folder.journal_path.read_bytes().splitlines(keepends=True)
    folder.journal_path.write_bytes(b"".join(lines[:-1]))
    for module in ("program", "run_campaign"):
        monkeypatch.setattr(f"metro_hil.engine.{module}.program_version", lambda: "9.9.9+other")
    capsys.readouterr()

    code = main(["resume", "--json", "--despite-change"])

    document, _ = said(capsys)
    assert (code, document["done"]) == (1, 4)
    assert "more than one version" in document["problems"][0]


def master(*words: str) -> "subprocess.Popen[bytes]":
    return subprocess.Popen(
        [sys.executable, "-m", "metro_hil.cli.hil", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def children_of(pid: int) -> list[int]:
    """The children of a process with one thread."""
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii")
    return [int(word) for word in text.split()]


def until(condition: Any) -> None:
    clock = WallClock()
    end_ns = clock.now_ns() + round(GIVE_UP_S * NS_PER_S)
    while not condition():
        assert clock.now_ns() < end_ns, "it never came about"
        clock.wait_until(clock.now_ns() + NS_PER_S // 100)


def test_ctrl_c_gives_exit_code_130_a_hint_to_resume_and_loses_nothing() -> None:
    folder = begun_campaign(trial_cases(300, work_s=0.02))
    process = master("resume", "--json")
    until(lambda: len(read_journal(folder.journal_path).results) > 5)

    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=GIVE_UP_S)

    assert process.returncode == 130
    assert json.loads(output)["interrupted"] is True
    assert f"hil resume {folder.path}" in errors.decode()
    assert main(["resume", "--json"]) == 0


def test_workers_end_with_a_killed_master() -> None:
    begun_campaign(trial_cases(300, work_s=0.05))
    process = master("resume", "--workers", "2", "--json")
    until(lambda: len(workers_of(process.pid)) == 2)
    workers = workers_of(process.pid)

    process.kill()
    process.communicate(timeout=GIVE_UP_S)

    until(lambda: not any(_alive(pid) for pid in workers))


def workers_of(master_pid: int) -> list[int]:
    """Processes that the fork server of a campaign has forked."""
    return [pid for server in children_of(master_pid) for pid in children_of(server)]


def _alive(pid: int) -> bool:
    """Whether the process lives; a zombie counts as dead."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False
    return text.rpartition(")")[2].split()[0] != "Z"


def test_the_shipped_smoke_campaign_runs_on_the_real_bench(
    capsys: pytest.CaptureFixture[str],
) -> None:
    code = main(["run", "smoke", "--limit", "1", "--json", "--no-report", "--keep-worst", "1"])

    document, _ = said(capsys)
    folder = find_folder(None)
    (result,) = read_journal(folder.journal_path).results
    assert (code, document["done"], document["problems"]) == (0, 1, [])
    assert len(result.chain) == 64
    assert folder.kept(result.case_id).bus_log.stat().st_size > 0
    assert len(folders()) == 1
    assert [path.name for path in Path("runs").iterdir()] == ["hil"]
