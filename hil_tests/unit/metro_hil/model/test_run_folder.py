"""The folder of a run is never that of another one."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import pytest

from metro_hil.model.run_folder import RunFolderError, discard_unused, make_run_folder

EPOCH_NS = 1_700_000_000_000_000_000
RUNS = 8


def test_runs_that_begin_in_the_same_second_have_separate_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for _ in range(20):
        together = Barrier(RUNS)

        def made(_: int, together: Barrier = together) -> Path:
            together.wait()
            return make_run_folder(None, EPOCH_NS, "loop").path

        with ThreadPoolExecutor(RUNS) as pool:
            paths = list(pool.map(made, range(RUNS)))
        assert len(set(paths)) == RUNS


def test_a_folder_that_another_run_creates_meanwhile_is_left_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    first = make_run_folder(None, EPOCH_NS, "loop").path
    monkeypatch.setattr(Path, "exists", lambda _: False)

    second = make_run_folder(None, EPOCH_NS, "loop").path

    assert second == first.with_name(f"{first.name}_2")


def test_a_requested_folder_is_used_if_it_is_empty(tmp_path: Path) -> None:
    folder = make_run_folder(str(tmp_path / "mine"), EPOCH_NS, "loop").path
    assert make_run_folder(str(folder), EPOCH_NS, "loop").path == folder
    (folder / "bus.log").touch()

    with pytest.raises(RunFolderError, match="not empty"):
        make_run_folder(str(folder), EPOCH_NS, "loop")


def test_an_unwritable_place_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").touch()

    with pytest.raises(RunFolderError, match="runs"):
        make_run_folder(None, EPOCH_NS, "loop")


def test_a_run_that_never_began_leaves_no_folder(tmp_path: Path) -> None:
    folder = make_run_folder(str(tmp_path / "refused"), 0, "hop")
    folder.config.write_text('bus = "embedded:vcan0"\n')
    folder.bus_log.touch()

    discard_unused(folder)

    assert not folder.path.exists()


@pytest.mark.parametrize("words", ["bus.log", "mine.txt"])
def test_a_folder_with_content_stays(tmp_path: Path, words: str) -> None:
    folder = make_run_folder(str(tmp_path / "run"), 0, "hop")
    folder.config.write_text("")
    (folder.path / words).write_text("kept")

    discard_unused(folder)

    assert {each.name for each in folder.path.iterdir()} == {words, folder.config.name}
