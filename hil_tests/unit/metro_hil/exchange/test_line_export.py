"""A line that is exported and imported again is the same line."""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.settings import build
from firmware_py.trackdb import LineMap, LineZone, load_line
from firmware_py.trackdb.sites import TUNNELS, ZONES
from metro_hil.exchange import export_command, import_command
from metro_hil.exchange.line_rules import FittedTrain, complete_line
from metro_hil.exchange.railml_export import railml_text
from metro_hil.exchange.railml_network import read_infrastructure
from metro_hil.exchange.survey import file_name
from metro_hil.exchange.surveyed_network import line_along
from metro_hil.exchange.xml_node import XmlNode, read_xml

MM: Final = 1000
SHIPPED: Final = ("florence", "nanakuma", "hefei", "loop")
KINDS: Final = ("t1", "t2", "t3", "stop")


def millimetres(low_m: float, high_m: float) -> st.SearchStrategy[float]:
    return st.integers(int(low_m * MM), int(high_m * MM)).map(lambda mm: mm / MM)


def cuts(draw: st.DrawFn, start_m: float, end_m: float, most: int) -> list[float]:
    """Places in rising order from one end to the other."""
    inner = draw(st.sets(millimetres(start_m + 1.0, end_m - 1.0), max_size=most))
    return [start_m, *sorted(inner), end_m]


def zones(draw: st.DrawFn, start_m: float, end_m: float) -> dict[str, Any]:
    """Tunnels, and zones of every kind, as tables of a line file."""
    divided = cuts(draw, start_m, end_m, 3) if draw(st.booleans()) else []
    return {
        "neutral_sections": [
            {"start_m": a, "end_m": b}
            for a, b in list(itertools.pairwise(cuts(draw, start_m, end_m, 4)))[1::2]
        ],
        "tunnels": [
            {"start_m": a, "end_m": b, "drag_ratio": draw(st.sampled_from((1.0, 1.6, 2.25)))}
            | ({"name": "<bore>"} if draw(st.booleans()) else {})
            for a, b in list(itertools.pairwise(cuts(draw, start_m, end_m, 4)))[::2]
        ],
        "power_sections": [
            {"start_m": a, "end_m": b, "name": f"S & {number}"}
            for number, (a, b) in enumerate(itertools.pairwise(divided))
        ],
        "no_stop_zones": [
            {
                "start_m": round(start_m + 3.0, 3),
                "end_m": round(start_m + 33.5, 3),
                "name": "<bore>",
            }
            for _ in range(draw(st.integers(0, 1)))
        ],
        "evacuation_stops": [{"start_m": 700.5, "end_m": 770.25, "name": "exit 1"}]
        if start_m < 700.5 and end_m > 770.25 and draw(st.booleans())
        else [],
    }


@st.composite
def lines(draw: st.DrawFn) -> LineMap:
    start_m = draw(millimetres(-900.0, 500.0))
    stations: list[dict[str, Any]] = []
    at_m = start_m + draw(millimetres(100.0, 200.0))
    for number in range(draw(st.integers(2, 5))):
        side = draw(st.sampled_from(("left", "right", "both", "none")))
        stations.append(
            {
                "name": f'Stop <{number}> & "é"',
                "stop_m": round(at_m, 3),
                "platform_start_m": round(at_m - draw(millimetres(1.0, 90.0)), 3),
                "platform_end_m": round(at_m + draw(millimetres(0.0, 9.0)), 3),
                "side": side,
                "dwell_s": 0.0 if side == "none" else draw(st.sampled_from((0.0, 20.0, 33.3))),
                "run_s": draw(st.sampled_from((0.0, 71.25))),
                "platform_doors": draw(st.booleans()),
                "short_stops": [{"train_length_max_m": 40.0, "stop_m": round(at_m - 0.5, 3)}]
                if draw(st.booleans())
                else [],
            }
        )
        at_m += draw(millimetres(120.0, 3000.0))
    end_m = round(at_m + 100.0, 3)
    tags = sorted(draw(st.sets(millimetres(start_m, end_m), max_size=8)))
    names = [None, *(station["name"] for station in stations)]
    table = {
        "name": "drawn-line",
        "description": draw(st.sampled_from(("", "Two lines\nof 'text' & <more>"))),
        "start_m": start_m,
        "end_m": end_m,
        "stations": stations,
        "speed_sections": [
            {"start_m": a, "end_m": b, "limit_mps": draw(st.floats(1.0, 40.0))}
            for a, b in itertools.pairwise(cuts(draw, start_m, end_m, 4))
        ],
        "gradients": [
            {"start_m": a, "end_m": b, "gradient_permille": draw(st.floats(-60.0, 60.0))}
            for a, b in itertools.pairwise(cuts(draw, start_m, end_m, 4))
            if draw(st.booleans())
        ],
        "curves": [
            {"start_m": a, "end_m": b, "radius_m": draw(st.floats(50.0, 5000.0))}
            for a, b in itertools.pairwise(cuts(draw, start_m, end_m, 4))
            if draw(st.booleans())
        ],
        "tags": [
            {"tag_id": number, "position_m": place_m}
            | ({"station": name, "kind": draw(st.sampled_from(KINDS))} if name else {})
            for number, place_m in enumerate(tags, start=1)
            for name in (draw(st.sampled_from(names)),)
        ],
        **zones(draw, start_m, end_m),
        "rollback_m": draw(st.sampled_from((2.0, 3.5))),
    }
    line: LineMap = build(LineMap, table, "drawn")
    return line


def same_everywhere(one: LineMap, other: LineMap) -> None:
    """The same places, and the same values between any two of them."""
    for name in (
        *("name", "description", "start_m", "end_m", "stations", "tags", "rollback_m"),
        *(TUNNELS, *ZONES),
    ):
        assert getattr(one, name) == getattr(other, name), name
    edges_m: set[float] = set()
    for line in (one, other):
        for sections in (line.speed_sections, line.gradients, line.curves):
            edges_m |= {m for each in sections for m in (each.start_m, each.end_m)}
    for start_m, end_m in itertools.pairwise(sorted(edges_m)):
        for at_m in (start_m, (start_m + end_m) / 2.0):
            assert one.limit_mps(at_m) == other.limit_mps(at_m)
            assert one.gradient_permille(at_m) == other.gradient_permille(at_m)
            assert one.radius_m(at_m) == other.radius_m(at_m)


def there_and_back(line: LineMap, folder: Path) -> LineMap:
    path = folder / "line.railml"
    path.write_text(railml_text(line), encoding="utf-8")
    assert import_command.main([str(path), "--out", str(folder), "--force"]) == 0
    return load_line(str(folder / f"{file_name(line.name)}.toml"))


@settings(max_examples=20, deadline=None)
@given(lines())
def test_railml_gives_the_same_line_again(line: LineMap) -> None:
    text = railml_text(line)
    root = XmlNode("line.railml", ElementTree.fromstring(text))  # noqa: S314 - our own text

    survey = line_along(read_infrastructure(root), ())
    table = complete_line(survey, FittedTrain("any", 60.0, 2.0)).table

    same_everywhere(build(LineMap, table, "line.railml"), line)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_line_comes_back(name: str, tmp_path: Path) -> None:
    line = load_line(name)

    same_everywhere(there_and_back(line, tmp_path), line)


def test_a_part_of_an_exported_line_can_be_chosen(tmp_path: Path) -> None:
    line = load_line("florence")
    path = tmp_path / "line.railml"
    path.write_text(railml_text(line), encoding="utf-8")
    names = [station.name for station in line.stations]

    survey = line_along(read_infrastructure(read_xml(path)), (names[1], names[3]))

    assert [at_m for _, at_m in survey.stops] == [line.stations[1].stop_m, line.stations[3].stop_m]


def test_ttobench_keeps_stops_limits_gradients_and_curves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = load_line("florence")
    out = tmp_path / "florence.json"

    assert export_command.main(["florence", "--as", "ttobench", "--out", str(out)]) == 0
    assert "left out: tags" in capsys.readouterr().out
    assert import_command.main([str(out), "--out", str(tmp_path)]) == 0

    back = load_line(str(tmp_path / "florence.toml"))
    shift_m = line.stations[0].stop_m
    assert [s.stop_m + shift_m for s in back.stations] == [s.stop_m for s in line.stations]
    at_m = line.stations[0].stop_m
    while at_m < line.stations[-1].stop_m:
        assert back.limit_mps(at_m - shift_m) == pytest.approx(line.limit_mps(at_m), abs=1e-9)
        assert back.gradient_permille(at_m - shift_m) == line.gradient_permille(at_m)
        assert back.radius_m(at_m - shift_m) == pytest.approx(line.radius_m(at_m))
        at_m += 7.3


def test_mistakes_of_an_export_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "there.railml"
    out.write_text("", encoding="utf-8")

    assert export_command.main(["florence", "--as", "railml", "--out", str(out)]) == 2
    assert "give --force to replace it" in capsys.readouterr().err
    assert export_command.main(["florenze", "--as", "railml"]) == 2
    assert "florenze" in capsys.readouterr().err


# The order in which the schemas of railML 3.2 have these elements.
GROUPS: Final = ("balises", "bufferStops", "electrifications", "lines", "operationalPoints")
MORE_GROUPS: Final = (
    "overCrossings",
    "platforms",
    "platformEdges",
    "speeds",
    "stoppingPlaces",
    "tracks",
)
REFERENCES: Final = ("ref", "netElementRef", "positioningSystemRef", "belongsToPlatform")
PARTS: Final = ("name", "isValid", "linearLocation", "spotLocation", "designator")


@settings(max_examples=10, deadline=None)
@given(lines())
def test_elements_have_the_order_of_the_schemas_and_ids_are_unique(line: LineMap) -> None:
    root = ElementTree.fromstring(railml_text(line))  # noqa: S314 - our own text
    tags = {node: node.tag.rpartition("}")[2] for node in root.iter()}
    functional = next(node for node, tag in tags.items() if tag == "functionalInfrastructure")

    order = [*GROUPS, *MORE_GROUPS]
    found = [tags[group] for group in functional]
    assert found == [name for name in order if name in found]
    for group in functional:
        for entity in group:
            heads = [tags[part] for part in entity]
            common = [name for name in heads if name in PARTS]
            assert common == sorted(common, key=PARTS.index)
            assert heads[: len(common)] == common
    ids = [node.get("id") for node in root.iter() if node.get("id") is not None]
    assert len(set(ids)) == len(ids)
    references = {value for node in root.iter() for key, value in node.items() if key in REFERENCES}
    assert references <= {*ids}


def test_zones_of_a_file_that_was_changed_badly_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = replace(load_line("florence"), neutral_sections=(LineZone(100.0, 130.0),))
    path = tmp_path / "line.railml"
    text = railml_text(line)
    assert text.count("&quot;start_m&quot;: 100.0") == 1
    path.write_text(text.replace("&quot;start_m&quot;: 100.0", "&quot;start&quot;: 1"), "utf-8")

    assert import_command.main([str(path), "--out", str(tmp_path)]) == 2
    assert "neutral_sections is no list of zones" in capsys.readouterr().err
