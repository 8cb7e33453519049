"""A file is replaced as a whole or stays unchanged, whatever interrupts the write."""

import os
from pathlib import Path

import pytest

from firmware_py.arguments import of_file
from firmware_py.storage.whole_file import PART, whole_file, write_whole
from hil_tests.disk_rig import small_disk


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("content", ["", "é\n", b"\xff\x00"])
def test_the_written_content_is_in_the_file(content: str | bytes, tmp_path: Path) -> None:
    path = tmp_path / "results.json"

    write_whole(path, content)

    assert path.read_bytes() == (content.encode() if isinstance(content, str) else content)
    assert names(tmp_path) == ["results.json"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_an_exception_leaves_the_old_content(error: type[BaseException], tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    path.write_text("old")

    def fail(part: Path) -> None:
        part.write_text("half of the n")
        raise error

    with pytest.raises(error), whole_file(path) as part:
        fail(part)

    assert path.read_text() == "old"
    assert names(tmp_path) == ["results.json"]


def test_a_full_disk_leaves_the_old_content_and_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    path.write_text("old")

    with small_disk(4096), pytest.raises(OSError, match="File too large") as caught:
        write_whole(path, b"x" * 10_000)

    assert of_file(caught.value) == f"{path}: File too large"
    assert path.read_text() == "old"
    assert names(tmp_path) == ["results.json"]


def test_the_leftover_of_a_killed_writer_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    (tmp_path / f"{PART}results.json").write_text("half of the n")

    write_whole(path, "new")

    assert path.read_text() == "new"
    assert names(tmp_path) == ["results.json"]


def test_the_suffix_stays_because_writers_derive_the_format_from_it(tmp_path: Path) -> None:
    with whole_file(tmp_path / "run.png") as part:
        assert part.suffix == ".png"
        part.write_text("")


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    link, target = tmp_path / "latest.json", tmp_path / "results.json"
    target.write_text("old")
    link.symlink_to(target)

    write_whole(link, "new")

    assert link.is_symlink()
    assert target.read_text() == "new"


def test_a_device_is_written_to_and_not_replaced() -> None:
    device = Path("/dev/full")

    with pytest.raises(OSError, match="No space left"):
        write_whole(device, "x")
    write_whole(Path(os.devnull), "x")

    assert device.is_char_device()


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    path = tmp_path / "absent" / "results.json"

    with pytest.raises(OSError, match="No such file") as caught:
        write_whole(path, "x")

    assert of_file(caught.value) == f"{path}: No such file or directory"
