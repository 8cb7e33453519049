"""The moving picture of a live run: the same log gives the same bytes."""

import itertools
import shutil
from pathlib import Path

import pytest
from PIL import Image, ImageSequence

from metro_tools import moving_picture

LOG = Path(__file__).resolve().parents[3] / "docs" / "examples" / "foreign_log" / "tram.log"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Ten seconds of another vehicle: the display says that it receives no controller."""
    shutil.copy(LOG, tmp_path / "bus.log")
    return tmp_path


def test_the_same_log_gives_the_same_bytes(run: Path, tmp_path: Path) -> None:
    made = [tmp_path / "a.gif", tmp_path / "b.gif"]

    for path in made:
        assert moving_picture.main([str(run), "-o", str(path)]) == 0

    assert made[0].read_bytes() == made[1].read_bytes()
    with Image.open(made[0]) as picture:
        assert len(list(ImageSequence.Iterator(picture))) > 1
        assert len(picture.convert("RGB").getcolors(10_000) or ()) > 2


def test_there_is_a_picture_for_every_step_after_the_first_seconds(run: Path) -> None:
    elapsed = [elapsed_s for _, _, elapsed_s in moving_picture.moments(run / "bus.log")]

    assert elapsed[0] == moving_picture.FROM_S
    assert {later - before for before, later in itertools.pairwise(elapsed)} == {
        moving_picture.FRAME_S
    }
    assert elapsed[-1] == 9.5


def test_a_run_without_a_log_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert moving_picture.main([str(tmp_path), "-o", str(tmp_path / "a.gif")]) == 2
    assert "bus.log" in capsys.readouterr().err
