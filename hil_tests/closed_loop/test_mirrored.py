"""A line and its mirrored copy, run in opposite directions, give the same frames."""

import itertools
from pathlib import Path

import pytest

from firmware_py.trackdb import LineMap, load_line
from firmware_py.trackdb.network import Running
from metro_hil.benchmarks import mirrored

LINE = """
name = "stub"
start_m = -90.0
end_m = 200.0
stations = [
    { name = "A", stop_m = 0.0, platform_start_m = -75.0, platform_end_m = 5.0, dwell_s = 1.0 },
    { name = "B", stop_m = 60.0, platform_start_m = -15.0, platform_end_m = 65.0, dwell_s = 1.0 },
]
speed_sections = [{ start_m = -90.0, end_m = 200.0, limit_mps = 9.0 }]
gradients = [{ start_m = 10.0, end_m = 40.0, gradient_permille = 15.0 }]
tags = [
    { tag_id = 4, position_m = -2.0, kind = "stop", station = "A" },
    { tag_id = 11, position_m = 8.0, kind = "t1", station = "B" },
    { tag_id = 12, position_m = 48.0, kind = "t2", station = "B" },
    { tag_id = 13, position_m = 56.5, kind = "t3", station = "B" },
    { tag_id = 14, position_m = 58.0, kind = "stop", station = "B" },
]
"""


def test_the_mirrored_line_gives_the_mirrored_run(tmp_path: Path) -> None:
    path = tmp_path / "stub.toml"
    path.write_text(LINE, encoding="utf-8")
    up, mirror = mirrored.directions(load_line(str(path)), Running.UP)

    run, other = (mirrored.one_way(each, "florence4", "florence4") for each in (up, mirror))

    assert (run.ended, run.made_count) == ("arrived", 1)
    assert run.worst_m < 0.1
    assert other == run


@pytest.mark.parametrize(("differs", "code"), [(False, 0), (True, 1)])
def test_a_run_that_differs_fails(
    differs: bool, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = itertools.count()

    def one_way(line: LineMap, consist: str, params: str) -> mirrored.OneWay:
        return mirrored.OneWay("arrived", str(next(runs) * differs), 9, (0.02, None))

    monkeypatch.setattr(mirrored, "one_way", one_way)

    assert mirrored.main(["florence"]) == code

    judged = f"{'NOT the same' if differs else 'the same'} on the mirrored line"
    assert capsys.readouterr().out.splitlines() == [
        f"florence {way}: arrived, 1 of 2 stops, worst 2.0 cm, 9 frames, {judged}"
        for way in ("up", "down")
    ]


def test_a_line_that_does_not_exist_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert mirrored.main(["nowhere"]) == 2

    assert "nowhere" in capsys.readouterr().err
