"""A circular line: the generated laps, and invalid circuits."""

import itertools
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from firmware_py.settings import SettingsError, find, parse
from firmware_py.trackdb import load_line

LAP_M = 16176.0


def shipped() -> dict[str, Any]:
    return parse(find("changping", "firmware_py.trackdb"))


def loaded(tmp_path: Path, table: dict[str, Any]) -> object:
    path = tmp_path / "round.toml"
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    return load_line(str(path))


def test_each_further_lap_is_the_first_one_shifted() -> None:
    line = load_line("changping")
    first, second = line.stations[:8], line.stations[8:16]

    assert [later.name for later in second] == [f"{each.name} 2" for each in first]
    assert [later.stop_m - each.stop_m for each, later in zip(first, second, strict=True)] == [
        pytest.approx(LAP_M)
    ] * 8
    assert line.limit_mps(100.0) == line.limit_mps(LAP_M + 100.0) == pytest.approx(22.22, abs=0.01)
    assert (
        line.limit_mps(7900.0) == line.limit_mps(LAP_M + 7900.0) == pytest.approx(11.11, abs=0.01)
    )


def test_the_way_back_is_as_long_as_the_way_there() -> None:
    stops_m = [station.stop_m for station in load_line("changping").stations[:8]]
    gaps_m = [far - near for near, far in itertools.pairwise(stops_m)]

    assert gaps_m[:3] == [3799.0, 2025.0, 1964.0]
    assert gaps_m[4:] == gaps_m[2::-1]


def test_every_tag_of_every_lap_has_a_unique_number() -> None:
    line = load_line("changping")

    assert len({tag.tag_id for tag in line.tags}) == len(line.tags) == 8 * 92
    served = [tag for tag in line.tags if tag.station == "Shahe south 3"]
    assert [round(line.station("Shahe south 3").stop_m - tag.position_m, 1) for tag in served] == [
        *(52.0, 12.0, 3.5, 2.0)
    ]


@pytest.mark.parametrize(
    ("circuit", "complaint"),
    [
        ({"laps": 0}, r"round\.toml:\d+: circuit: laps 0 is not in 1\.\.100"),
        ({"laps": 2, "lap": 1}, r"round\.toml:\d+: circuit\.lap: unknown key"),
        (7, r"round\.toml:\d+: circuit: 7 is not a table"),
    ],
)
def test_an_invalid_circuit_is_refused_by_name(
    circuit: object, complaint: str, tmp_path: Path
) -> None:
    with pytest.raises(SettingsError, match=complaint):
        loaded(tmp_path, {**shipped(), "circuit": circuit})


def test_a_tag_number_that_collides_with_the_next_lap_is_refused(tmp_path: Path) -> None:
    table = shipped()
    table["tags"][0]["tag_id"] = 100_104

    with pytest.raises(SettingsError, match=r"circuit: tags: tag 100104"):
        loaded(tmp_path, table)
