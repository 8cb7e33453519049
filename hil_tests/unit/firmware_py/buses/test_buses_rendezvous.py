"""The folder where the processes of a bench meet: private, predictable and safe from other
users."""

import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from firmware_py import rendezvous
from firmware_py.rendezvous import RendezvousError


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A runtime folder with a short name, because the address of a socket holds few bytes."""
    with tempfile.TemporaryDirectory() as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield Path(folder)


def test_a_bench_has_a_private_folder_by_user_and_bus(runtime: Path) -> None:
    folder = rendezvous.bench_dir("vcan0")

    assert folder == runtime / f"metro-bench-{os.getuid()}" / "vcan0"
    for made in (folder, folder.parent):
        assert stat.S_IMODE(made.stat().st_mode) == 0o700


def test_asking_again_gives_the_same_folder_and_keeps_its_content(runtime: Path) -> None:
    (rendezvous.bench_dir("vcan0") / "note").write_text("kept")

    assert (rendezvous.bench_dir("vcan0") / "note").read_text() == "kept"


def test_a_folder_that_others_could_enter_is_closed(runtime: Path) -> None:
    rendezvous.bench_dir("vcan0").chmod(0o777)

    assert stat.S_IMODE(rendezvous.bench_dir("vcan0").stat().st_mode) == 0o700


def test_without_a_runtime_folder_it_lies_with_the_temporary_files(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(runtime))

    monkeypatch.delenv("XDG_RUNTIME_DIR")
    without = rendezvous.bench_dir("vcan0")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime / "is-not-there"))
    stale = rendezvous.bench_dir("vcan0")

    assert without == stale == runtime / f"metro-bench-{os.getuid()}" / "vcan0"


@pytest.mark.parametrize("level", ["above", "bus"])
@pytest.mark.parametrize("trick", ["link", "file"])
def test_a_link_or_a_file_in_its_place_is_refused_and_left_alone(
    runtime: Path, level: str, trick: str
) -> None:
    elsewhere = runtime / "elsewhere"
    elsewhere.mkdir()
    above = runtime / f"metro-bench-{os.getuid()}"
    place = above if level == "above" else above / "vcan0"
    place.parent.mkdir(exist_ok=True)
    if trick == "link":
        place.symlink_to(elsewhere)
    else:
        place.write_text("")

    with pytest.raises(RendezvousError, match=f"^{place}: "):
        rendezvous.bench_dir("vcan0")
    assert list(elsewhere.iterdir()) == []


def test_a_folder_of_another_user_is_refused(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only root could create such a folder, so the process pretends to be another user."""
    owner = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: owner + 1)

    with pytest.raises(RendezvousError, match=f"belongs to user {owner}, not to you"):
        rendezvous.bench_dir("vcan0")


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "../x", "a" * 16, "a b", "-x", "ä", "a\0"])
def test_a_name_that_is_no_interface_name_is_refused(runtime: Path, name: str) -> None:
    with pytest.raises(RendezvousError, match="bus name"):
        rendezvous.bench_dir(name)
    assert list(runtime.iterdir()) == []


def test_a_socket_path_that_is_too_long_is_refused_with_a_remedy(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    deep = runtime / ("d" * 100)
    deep.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(deep))

    with pytest.raises(RendezvousError, match="set XDG_RUNTIME_DIR to a shorter folder"):
        rendezvous.hub_socket("vcan0")


def test_published_tags_lead_to_the_newest_device(runtime: Path) -> None:
    rendezvous.publish_tags("vcan0", "/dev/pts/7")
    link = rendezvous.publish_tags("vcan0", "/dev/pts/8")

    assert link == rendezvous.tags_link("vcan0") == rendezvous.bench_dir("vcan0") / "tags"
    assert os.readlink(link) == "/dev/pts/8"  # noqa: PTH115 - the text of the link, not the file


def test_a_published_radio_is_read_back_until_withdrawn(runtime: Path) -> None:
    assert rendezvous.read_radio("vcan0") is None

    rendezvous.publish_radio("vcan0", "tcp/127.0.0.1:7447")
    rendezvous.publish_tags("vcan0", "/dev/pts/7")
    assert rendezvous.read_radio("vcan0") == "tcp/127.0.0.1:7447"
    assert rendezvous.read_radio("vcan1") is None

    rendezvous.withdraw("vcan0")
    rendezvous.withdraw("vcan0")
    assert rendezvous.read_radio("vcan0") is None
    assert not rendezvous.tags_link("vcan0").is_symlink()


@pytest.mark.parametrize("content", [b"", b"  \n", b"\xff\xfe"])
def test_an_invalid_radio_note_counts_as_none(runtime: Path, content: bytes) -> None:
    rendezvous.radio_note("vcan0").write_bytes(content)

    assert rendezvous.read_radio("vcan0") is None


def test_only_published_files_are_left_in_the_folder(runtime: Path) -> None:
    rendezvous.publish_tags("vcan0", "/dev/pts/7")
    rendezvous.publish_radio("vcan0", "tcp/127.0.0.1:7447")

    left = sorted(path.name for path in rendezvous.bench_dir("vcan0").iterdir())
    assert left == ["radio", "tags"]
