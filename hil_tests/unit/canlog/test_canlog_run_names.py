"""How a word on the command line selects a run, and where `runs/latest` points."""

import os
from pathlib import Path

import pytest

from canlog.damage import LogError
from canlog.run import bus_log_of
from canlog.run_names import choose_run, forget_removed, mark_latest
from metro_hil.report.explain.event_log import RunEventsError, read_story

HOP = "2026-11-26T10-00-00_florence_II-III"
LINE = "2026-11-26T11-00-00_florence_Start-III"
LATER = "2026-11-27T09-00-00_line_loop"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Return three runs, started in order of their names, beside a folder of campaigns."""
    for number, name in enumerate((HOP, LINE, LATER), start=1):
        folder = tmp_path / "runs" / name
        folder.mkdir(parents=True)
        (folder / "run.toml").write_text("", encoding="utf-8")
        os.utime(folder / "run.toml", ns=(number * 10**9, number * 10**9))
    (tmp_path / "runs" / "hil").mkdir()
    return tmp_path / "runs"


@pytest.mark.parametrize(
    ("word", "name"),
    [
        (HOP, HOP),
        ("2026-11-27", LATER),
        ("_II-III", HOP),
        ("Start", LINE),
        ("latest", LATER),
        (None, LATER),
    ],
)
def test_a_run_is_found_by_a_unique_part_of_its_name(
    root: Path, word: str | None, name: str
) -> None:
    assert choose_run(word, "canlog", root) == root / name


def test_the_choice_is_reported_unless_its_path_was_typed(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    choose_run(root / HOP, "canlog", root)
    assert capsys.readouterr().err == ""

    choose_run("Start", "canlog", root)
    assert capsys.readouterr().err == f"canlog: reading {root / LINE}\n"


def test_a_beginning_goes_before_other_parts(root: Path) -> None:
    (root / "III").mkdir()
    (root / "III" / "bus.log").touch()

    assert choose_run("II", "canlog", root) == root / "III"


def test_several_matches_are_listed_the_newest_first(root: Path) -> None:
    with pytest.raises(LogError) as caught:
        choose_run("florence", "canlog", root)

    assert str(caught.value).splitlines() == [
        "florence: 2 runs match; write more of one name",
        f"  {LINE}",
        f"  {HOP}",
    ]


def test_a_folder_that_holds_no_run_is_no_candidate(root: Path) -> None:
    with pytest.raises(LogError, match=r"hil: no such file, and no run below .*/ has that"):
        choose_run("hil", "canlog", root)


def test_names_of_files_are_left_to_the_reader(root: Path) -> None:
    for word in ("missing.log", "elsewhere/missing"):
        assert choose_run(word, "canlog", root) == Path(word)


def test_without_any_run_the_message_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no run there; name a folder, or make one with `vobc run`"):
        choose_run(None, "canlog", tmp_path / "runs")


def test_latest_is_the_run_that_started_last_even_if_another_ends_later(root: Path) -> None:
    mark_latest(root / LATER, root)
    mark_latest(root / HOP, root)

    assert (root / "latest").resolve() == (root / HOP).resolve()
    assert (root / "latest").readlink() == Path(HOP)
    assert choose_run(None, "canlog", root) == root / HOP
    assert choose_run(root / "latest", "canlog", root) == root / HOP


def test_a_run_outside_of_the_folder_can_be_the_latest(root: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()

    mark_latest(elsewhere, root)

    assert choose_run(None, "canlog", root).samefile(elsewhere)


def test_no_folder_for_runs_is_made_for_the_sake_of_the_link(tmp_path: Path) -> None:
    mark_latest(tmp_path, tmp_path / "runs")

    assert not (tmp_path / "runs").exists()


def test_a_real_folder_named_latest_is_left_alone(root: Path) -> None:
    (root / "latest").mkdir()

    mark_latest(root / HOP, root)

    assert not (root / "latest").is_symlink()
    assert sorted(path.name for path in root.iterdir()) == sorted(
        [HOP, LINE, LATER, "hil", "latest"]
    )


def test_a_removed_run_gives_its_place_to_the_newest_that_is_left(root: Path) -> None:
    mark_latest(root / HOP, root)
    (root / HOP / "run.toml").unlink()
    (root / HOP).rmdir()

    assert choose_run(None, "canlog", root) == root / LATER
    forget_removed(root)
    assert (root / "latest").readlink() == Path(LATER)


def test_of_a_run_of_several_trains_one_has_to_be_named(root: Path) -> None:
    for train in ("train2", "train1"):
        (root / LATER / train).mkdir()
        (root / LATER / train / "bus.log").touch()
        (root / LATER / train / "events.jsonl").touch()
    words = f"{root / LATER}: a run of several trains; name one of its folders, such as "

    with pytest.raises(LogError) as caught:
        bus_log_of(root / LATER)
    assert str(caught.value) == words + str(root / LATER / "train1")

    with pytest.raises(RunEventsError) as told:
        read_story(root / LATER)
    assert str(told.value) == words + str(root / LATER / "train1")
