"""Networks in files: check, show, draw, routes, and mistakes with file, key and value."""

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Final

import pytest

from firmware_py.settings import SettingsError
from firmware_py.trackdb import load_line
from firmware_py.trackdb.circuit import load_network
from metro_hil.model.run_options import parse
from metro_hil.report.network_command import main
from metro_hil.report.network_diagram import network_svg
from metro_hil.run.turnback import trips_of

JUNCTION: Final = Path(__file__).resolve().parents[4] / "docs/examples/line/junction.toml"
SVG: Final = "{http://www.w3.org/2000/svg}"


def changed(folder: Path, before: str, after: str) -> str:
    text = JUNCTION.read_text(encoding="utf-8")
    assert before in text
    path = folder / "mine.toml"
    path.write_text(text.replace(before, after, 1), encoding="utf-8")
    return str(path)


def test_a_route_runs_over_tracks_with_their_own_chainages() -> None:
    out, back = (load_line(f"{JUNCTION}:{route}") for route in ("out", "back"))

    assert [(each.name, each.stop_m) for each in out.stations] == [
        ("Mill", 0.0),
        ("Lock", 700.0),
        ("Pier", 1145.0),
    ]
    assert [each.name for each in back.stations] == ["Pier", "Lock", "Mill"]
    # 300 m of the west track climb for a train that runs up, so they fall for this one.
    assert back.gradient_permille(back.station("Lock").stop_m + 300.0) == -15.0


@pytest.mark.parametrize("name", [str(JUNCTION), "florence"])
def test_the_diagram_shows_every_track_and_platform(name: str) -> None:
    network = load_network(name)

    root = ET.fromstring(network_svg(network))  # noqa: S314 - text of this test's own program

    lines = [each.get("class") for each in root.iter(f"{SVG}line")]
    platforms = sum(len(track.platforms) for track in network.tracks)
    assert lines.count("track") == len(network.tracks)
    assert lines.count("stop") == len(network.buffer_stops)
    assert len(list(root.iter(f"{SVG}rect"))) == platforms
    for line in root.iter(f"{SVG}line"):
        assert 0.0 <= float(str(line.get("x1"))) <= 1100.0


def test_check_and_show_name_routes_and_switches(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(JUNCTION)]) == 0
    assert main(["show", str(JUNCTION)]) == 0

    printed = capsys.readouterr().out
    assert "route back fits the parameters florence4" in printed
    assert "switch W1: pier.start to west.end (left), east.end (right)" in printed


def test_a_route_that_does_not_fit_the_train_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = changed(tmp_path, "gradient_permille = 15.0", "gradient_permille = 110.0")

    assert main(["check", name]) == 2
    assert "line junction-out: gradients: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("before", "after", "problem"),
    [
        ('right = "east.end"', 'right = ""', "switches: W1: right has no track end"),
        ('right = "east.end"\n', "", "switches[0].right: missing key"),
        ('right = "east.end"', 'right = "west.end"', "two tracks would lie at one place"),
        ('legs = ["east up", "pier up"]', 'legs = ["pier up", "east up"]', "no join or switch"),
        ('legs = ["east up", "pier up"]', 'legs = ["east"]', "write the track and up or down"),
        ('legs = ["east up", "pier up"]', 'legs = ["est up"]', "has no track est"),
        ('direction = "up"', 'direction = "both"', "serves one stopping point"),
        ("stop_up_m = 0.0", "stop_up_m = 9.0", "stop_up_m 9.0 of Mill is not along its platform"),
        ("tag_id = 2,", "tag_id = 22,", "tag_id 22 is on track east and on track west"),
    ],
)
def test_a_mistake_names_file_and_place(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    before: str,
    after: str,
    problem: str,
) -> None:
    name = changed(tmp_path, before, after)

    assert main(["check", name]) == 2

    error = capsys.readouterr().err
    assert error.startswith(f"vobc network: {name}")
    assert problem in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("route", "problem"),
    [("", "name one of its routes"), (":bak", "nearest valid route: back")],
)
def test_a_network_needs_one_of_its_routes(route: str, problem: str) -> None:
    with pytest.raises(SettingsError, match=problem):
        load_line(f"{JUNCTION}{route}")


def test_a_train_turns_only_onto_a_route_that_leaves_over_its_track() -> None:
    words = ["run", "--lockstep", "--line", f"{JUNCTION}:out", "--and-back"]

    _, back = trips_of(parse([*words, "back"]))

    assert (back.start, back.end) == ("Pier", "Mill")
    with pytest.raises(SettingsError, match="does not leave Lock over track east, where"):
        trips_of(parse([*words, "back", "--to", "Lock"]))
    with pytest.raises(SettingsError, match="name the route back"):
        trips_of(parse(words))


def test_show_and_draw_name_the_zones(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    zone = '\n[[tracks.neutral_sections]]\nstart_m = 450.0\nend_m = 480.0\nname = "gap"\n'
    zone += zone.replace("neutral", "power").replace("gap", "Lock & Mill")
    zone += "\n[[tracks.tunnels]]\nstart_m = 500.0\nend_m = 600.0\ndrag_ratio = 2.25\n"
    text = JUNCTION.read_text(encoding="utf-8")
    first = text.index("[[tracks]]")
    second = text.index("[[tracks]]", first + 1)
    path = tmp_path / "mine.toml"
    path.write_text(text[:second] + zone + "\n" + text[second:], encoding="utf-8")

    assert main(["show", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "neutral section gap, 450 m to 480 m, both" in shown
    assert "power section Lock & Mill, 450 m to 480 m, both" in shown
    drawn = network_svg(load_network(str(path)))
    assert drawn.count('class="neutral"') == 1
    assert ">gap<" in drawn
    assert "tunnel, 500 m to 600 m, air drag × 2.25" in shown
    assert drawn.count('class="tunnel"') == 1
    assert drawn.count('class="power"') == 1
    assert ">Lock &amp; Mill<" in drawn
