"""`hil resume` repeats the results that a power cut or a full disk damaged, up to the same
reports."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec
import pytest

from hil_tests.disk_rig import small_disk
from metro_hil.cli.hil import main
from metro_hil.engine.folder import CampaignFolder, CampaignPlan, make_folder
from metro_hil.engine.retention import SEAL, kept_result
from metro_hil.engine.trial_runner import trial_cases
from metro_hil.report.campaign.write import FILES

RUNNER: Final = "metro_hil.engine.trial_runner:run_case"
CASES: Final = 6
KEPT: Final = 2
FAILED: Final = "trial/0003-s4"


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> CampaignFolder:
    """A campaign that ran without disturbance."""
    cases = list(trial_cases(CASES))
    setup = msgspec.structs.replace(cases[3].setup, real={"trial.verdict": "fail"})
    cases[3] = msgspec.structs.replace(cases[3], setup=setup)
    options = {"runner": RUNNER, "keep": 1, "keep_worst": KEPT - 1}
    plan = CampaignPlan(name="trial", cases=cases, files={"line": "a = 1"}, options=options)
    folder = make_folder(plan, str(tmp_path_factory.mktemp("finished") / "campaign"))
    assert main(["resume", str(folder.path), "--json"]) == 1
    return folder


@pytest.fixture
def folder(finished: CampaignFolder, tmp_path: Path) -> CampaignFolder:
    """A copy of the campaign that a test damages."""
    return CampaignFolder(shutil.copytree(finished.path, tmp_path / "campaign"))


def kept_of(folder: CampaignFolder) -> Path:
    """The folder of the failed case."""
    return folder.kept(FAILED).path


def cut(path: Path, size: int) -> None:
    path.write_bytes(path.read_bytes()[:size])


def fill(path: Path) -> None:
    """Keep the length of the file but replace its content by zeros."""
    path.write_bytes(bytes(path.stat().st_size))


def damage_a_line(path: Path) -> None:
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:3], b"\0" * (len(lines[3]) - 1) + b"\n", *lines[4:]]))


def tear_the_last_line(path: Path) -> None:
    cut(path, path.stat().st_size - 9)


def each_report(folder: CampaignFolder, damage: Callable[[Path], object]) -> None:
    for name in FILES:
        damage(folder.path / name)


DAMAGES: Final[dict[str, Callable[[CampaignFolder], object]]] = {
    "result empty": lambda folder: cut(kept_of(folder) / "results.json", 0),
    "result half": lambda folder: cut(kept_of(folder) / "results.json", 200),
    "result of zeros": lambda folder: fill(kept_of(folder) / "results.json"),
    "result missing": lambda folder: (kept_of(folder) / "results.json").unlink(),
    "log empty": lambda folder: cut(kept_of(folder) / "bus.log", 0),
    "log half": lambda folder: cut(kept_of(folder) / "bus.log", 5),
    "log of zeros": lambda folder: fill(kept_of(folder) / "bus.log"),
    "log missing": lambda folder: (kept_of(folder) / "bus.log").unlink(),
    "seal half": lambda folder: cut(kept_of(folder) / SEAL, 9),
    "seal missing": lambda folder: (kept_of(folder) / SEAL).unlink(),
    "folder of the case missing": lambda folder: shutil.rmtree(kept_of(folder)),
    "folder of all cases missing": lambda folder: shutil.rmtree(folder.path / "cases"),
    "journal torn": lambda folder: tear_the_last_line(folder.journal_path),
    "journal damaged in the middle": lambda folder: damage_a_line(folder.journal_path),
    "journal with a tail of zeros": lambda folder: folder.journal_path.write_bytes(
        folder.journal_path.read_bytes() + bytes(4096)
    ),
    "journal empty": lambda folder: cut(folder.journal_path, 0),
    "journal of zeros": lambda folder: fill(folder.journal_path),
    "journal missing": lambda folder: folder.journal_path.unlink(),
    "lock missing": lambda folder: folder.journal_path.with_suffix(".lock").unlink(),
    "reports empty": lambda folder: each_report(folder, lambda path: cut(path, 0)),
    "reports missing": lambda folder: each_report(folder, Path.unlink),
    "halves of reports beside": lambda folder: [
        (folder.path / f".part.{name}").write_bytes(b"half") for name in FILES
    ],
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_results_are_repeated_to_the_same_reports(
    damage: str,
    folder: CampaignFolder,
    finished: CampaignFolder,
    capsys: pytest.CaptureFixture[str],
) -> None:
    DAMAGES[damage](folder)

    code = main(["resume", str(folder.path), "--json"])

    assert code == 1
    for name in FILES:
        healed, wanted = (each.path / name for each in (folder, finished))
        assert healed.read_bytes() == wanted.read_bytes(), name
    assert kept_result(folder.kept(FAILED)) is not None
    assert (kept_of(folder) / "bus.log").read_text() == f"{FAILED}\n"
    assert not [*folder.path.glob(".part.*")]
    assert "NOT DETERMINISTIC" not in capsys.readouterr().out


@pytest.mark.parametrize("size", [0, 100, 700, 2000, 4000])
def test_a_full_disk_ends_the_campaign_with_one_line_and_it_resumes_later(
    size: int,
    folder: CampaignFolder,
    finished: CampaignFolder,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder.journal_path.unlink()
    shutil.rmtree(folder.path / "cases")
    for name in FILES:
        (folder.path / name).unlink()

    with small_disk(size):
        ended = main(["resume", str(folder.path)])
    errors = capsys.readouterr().err
    resumed = main(["resume", str(folder.path), "--json"])

    assert ended == 3
    assert errors.splitlines()[-1].endswith(f"; nothing is lost: hil resume {folder.path}")
    assert "File too large" in errors
    assert resumed == 1
    for name in FILES:
        healed, wanted = (each.path / name for each in (folder, finished))
        assert healed.read_bytes() == wanted.read_bytes(), name
