"""Tracks and trains of railML 3 become files that run; bad files give file and element."""

from pathlib import Path
from typing import Final

import pytest

from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap, PlatformSide, load_line
from firmware_py.trackdb.circuit import load_network
from firmware_py.trackdb.network import Running
from metro_hil.exchange.import_command import main
from metro_hil.exchange.railml_network import read_infrastructure
from metro_hil.exchange.surveyed_network import line_along
from metro_hil.exchange.xml_node import read_xml
from plant_emulator.train_config import load_train
from vobc.config import load_config
from vobc.plausible import implausible

# West (w) leads over the switch S1 to East on the main track (m) or on the loop (l). The main track
# runs against its netElement, and its length comes from chainages in kilometres.
TRACKS: Final = """<?xml version="1.0" encoding="UTF-8"?>
<railML xmlns="https://www.railml.org/schemas/3.2" version="3.2">
 <common id="co"><positioning><linearPositioningSystems>
  <linearPositioningSystem id="km" units="km" startMeasure="0" endMeasure="3"
   linearReferencingMethod="absolute"><isValid/></linearPositioningSystem>
 </linearPositioningSystems></positioning></common>
 <infrastructure id="is"><topology>
  <netElements>
   <netElement id="w" length="1000"/>
   <netElement id="m"><associatedPositioningSystem id="a">
    <intrinsicCoordinate id="a0" intrinsicCoord="0">
     <linearCoordinate positioningSystemRef="km" measure="2.6"/></intrinsicCoordinate>
    <intrinsicCoordinate id="a1" intrinsicCoord="1">
     <linearCoordinate positioningSystemRef="km" measure="1.0"/></intrinsicCoordinate>
   </associatedPositioningSystem></netElement>
   <netElement id="l"/>
   <netElement id="all"><elementCollectionUnordered id="c">
    <elementPart ref="w"/><elementPart ref="m"/></elementCollectionUnordered></netElement>
  </netElements>
  <netRelations>
   <netRelation id="wm" positionOnA="1" positionOnB="1" navigability="Both">
    <elementA ref="w"/><elementB ref="m"/></netRelation>
   <netRelation id="wl" positionOnA="1" positionOnB="0" navigability="Both">
    <elementA ref="w"/><elementB ref="l"/></netRelation>
   <netRelation id="ml" positionOnA="1" positionOnB="0" navigability="None">
    <elementA ref="m"/><elementB ref="l"/></netRelation>
  </netRelations>
  <networks><network id="n"><level id="lv"/></network></networks></topology>
  <geometry>
   <horizontalCurves><horizontalCurve id="hc" curveType="arc" radius="-400">
    <linearLocation id="hl"><associatedNetElement netElementRef="w" keepsOrientation="true"
     intrinsicCoordBegin="0.5" intrinsicCoordEnd="0.7"/></linearLocation>
   </horizontalCurve></horizontalCurves>
   <gradientCurves><gradientCurve id="gc" curveType="straight" gradient="10">
    <linearLocation id="gl"><associatedNetElement netElementRef="m" keepsOrientation="true"
     posBegin="1000" posEnd="1600"/></linearLocation></gradientCurve></gradientCurves>
  </geometry>
  <functionalInfrastructure>
   <bufferStops><bufferStop id="b"><spotLocation id="bl" netElementRef="w" pos="0"/></bufferStop>
   </bufferStops>
   <operationalPoints>
    <operationalPoint id="o1"><name name="West" language="en"/>
     <spotLocation id="o1l" netElementRef="w" pos="200"/></operationalPoint>
    <operationalPoint id="o2"><name name="East" language="en"/>
     <opEquipment><ownsPlatform ref="p"/></opEquipment></operationalPoint>
   </operationalPoints>
   <platforms><platform id="p"><linearLocation id="pl">
    <associatedNetElement netElementRef="m" keepsOrientation="true">
     <linearCoordinateBegin positioningSystemRef="km" measure="2.5" lateralSide="left"/>
     <linearCoordinateEnd positioningSystemRef="km" measure="2.3"/></associatedNetElement>
    </linearLocation></platform></platforms>
   <speeds>
    <speedSection id="v1" maxSpeed="72"><linearLocation id="v1l" applicationDirection="both">
     <associatedNetElement netElementRef="w" keepsOrientation="true"/></linearLocation>
    </speedSection>
    <speedSection id="v2" maxSpeed="36"><linearLocation id="v2l" applicationDirection="reverse">
     <associatedNetElement netElementRef="m" keepsOrientation="true" posBegin="0" posEnd="400"/>
     </linearLocation></speedSection>
    <speedSection id="v3" maxSpeed="18"><linearLocation id="v3l" applicationDirection="normal">
     <associatedNetElement netElementRef="m" keepsOrientation="true"/></linearLocation>
    </speedSection>
   </speeds>
   <switchesIS><switchIS id="s"><name name="S1" language="en"/>
    <leftBranch netRelationRef="wl"/><rightBranch netRelationRef="wm"/></switchIS></switchesIS>
   <tracks><track id="t" type="mainTrack"><linearLocation id="tl">
    <associatedNetElement netElementRef="l" keepsOrientation="true"/></linearLocation>
    <length type="physical" value="1500"/></track></tracks>
  </functionalInfrastructure></infrastructure>
 <rollingstock>
  <vehicles><vehicle id="v" bruttoWeight="45" length="20" speed="80">
   <designator register="r" entry="car"/>
   <engine id="e"><tractiveEffort><valueTable xValueName="v" xValueUnit="km/h" yValueName="F"
    yValueUnit="N">
    <valueLine xValue="0"><value yValue="60000"/></valueLine>
    <valueLine xValue="36"><value yValue="60000"/></valueLine>
    <valueLine xValue="72"><value yValue="30000"/></valueLine>
   </valueTable></tractiveEffort></engine></vehicle></vehicles>
  <formations><formation id="f" speed="72"><designator register="r" entry="Two"/>
   <trainOrder orderNumber="1" vehicleRef="v"/><trainOrder orderNumber="2" vehicleRef="v"/>
   <trainEngine maxAcceleration="1.0"/><trainBrakes brakeType="none" meanDeceleration="0.9"/>
   <trainResistance><valueTable xValueName="v" xValueUnit="m/s" yValueName="F" yValueUnit="N">
    <valueLine xValue="0"><value yValue="2000"/></valueLine>
    <valueLine xValue="10"><value yValue="3100"/></valueLine>
    <valueLine xValue="20"><value yValue="6400"/></valueLine>
   </valueTable></trainResistance></formation></formations></rollingstock>
</railML>
"""


def written(folder: Path, *changes: tuple[str, str]) -> Path:
    """The file with some of its text replaced."""
    text = TRACKS
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "net.railml"
    path.write_text(text, encoding="utf-8")
    return path


def imported(folder: Path, *arguments: str) -> LineMap:
    path = written(folder)
    assert main([str(path), *arguments, "--out", str(folder / "out")]) == 0
    return load_line(str(folder / "out" / "net.toml"))


@pytest.mark.parametrize(
    ("line_type", "child", "neutral", "text"),
    [
        ("none", "", True, ""),
        ("none", "<whole/>", False, "a whole track without power"),
        ("overhead", "", False, "the begin of w and the end of w leave a gap at 0 m of w"),
        ("overhead", '<phaseSeparationSection lengthPhaseSeparation="200"/>', True, ""),
        ("thirdRail", '<systemSeparationSection lengthSystemSeparation="199"/>', True, ""),
        (
            "overhead",
            '<phaseSeparationSection lengthPhaseSeparation="198"/>',
            False,
            "where in its 200 m the separation of 198 m lies",
        ),
    ],
)
def test_sections_without_power_are_neutral_sections(
    line_type: str, child: str, neutral: bool, text: str, tmp_path: Path
) -> None:
    element = (
        f'<electrifications><electrificationSection id="e1" contactLineType="{line_type}">{child}'
        '<linearLocation id="el"><associatedNetElement netElementRef="m" keepsOrientation="true" '
        'posBegin="1400" posEnd="1600"/></linearLocation></electrificationSection>'
        "</electrifications><speeds>"
    )
    if child == "<whole/>":
        element = element.replace('posBegin="1400" posEnd="1600"', "")
    path = tmp_path / "power.railml"
    path.write_text(TRACKS.replace("<speeds>", element), encoding="utf-8")

    network = read_infrastructure(read_xml(path))

    found = [(zone.key, zone.track, zone.begin_m, zone.end_m) for zone in network.zones]
    assert found == ([("neutral_sections", "m", 1400.0, 1600.0)] if neutral else [])
    assert text in "".join(network.ignored)


def section(name: str, track: str, ends: str = "", child: str = "") -> str:
    return (
        f'<electrificationSection id="{name}" contactLineType="overhead">{child}'
        f'<linearLocation id="{name}l"><associatedNetElement netElementRef="{track}" '
        f'keepsOrientation="true" {ends}/></linearLocation></electrificationSection>'
    )


MAIN: Final = section("S1", "m", 'posBegin="0" posEnd="700"') + section("S2", "m", 'posBegin="700"')


@pytest.mark.parametrize(
    ("sections", "named", "text"),
    [
        (section("S0", "w") + section("S3", "l") + MAIN, "S0 S1 S2 S3", ""),
        # A section that others divide says nothing that they do not say.
        (
            section("all", "m")
            + section("S0", "w")
            + section("S3", "l")
            + MAIN.replace('"overhead">', '"overhead"><belongsToParent ref="all"/>'),
            "S0 S1 S2 S3",
            "",
        ),
        (section("S0", "w") + section("S3", "l") + section("S1", "m") * 2, "", "S1 and S1 overlap"),
        (section("S0", "w") + MAIN, "", "the begin of l and the end of l leave a gap at 0 m of l"),
        (
            section("S0", "w") + section("S3", "l") + MAIN.replace('End="700"', 'End="690"'),
            "",
            "S1 and S2 leave a gap at 690 m of m",
        ),
    ],
)
def test_sections_that_cover_each_track_once_are_power_sections(
    sections: str, named: str, text: str, tmp_path: Path
) -> None:
    path = tmp_path / "power.railml"
    group = f"<electrifications>{sections}</electrifications><speeds>"
    path.write_text(TRACKS.replace("<speeds>", group), encoding="utf-8")

    network = read_infrastructure(read_xml(path))

    assert " ".join(sorted(each.name for each in network.zones)) == named
    assert {each.key for each in network.zones} <= {"power_sections"}
    assert text in "".join(network.ignored)


def test_a_crossing_that_is_a_tunnel_becomes_one_with_a_stated_ratio(tmp_path: Path) -> None:
    element = (
        '<overCrossings><overCrossing id="t1" constructionType="tunnel">'
        '<name name="Hill" language="en"/><linearLocation id="t1l"><associatedNetElement '
        'netElementRef="m" keepsOrientation="true" posBegin="600" posEnd="900"/></linearLocation>'
        '</overCrossing><overCrossing id="b1" constructionType="bridge"><linearLocation id="b1l">'
        '<associatedNetElement netElementRef="w" keepsOrientation="true" posBegin="1" posEnd="9"/>'
        "</linearLocation></overCrossing></overCrossings><platforms>"
    )
    path = written(tmp_path, ("<platforms>", element))

    assert main([str(path), "--stops", "West,East", "--out", str(tmp_path / "line")]) == 0
    assert main([str(path), "--out", str(tmp_path / "net")]) == 0

    (tunnel,) = load_line(str(tmp_path / "line" / "net.toml")).tunnels
    assert (tunnel.end_m - tunnel.start_m, tunnel.drag_ratio, tunnel.name) == (300.0, 1.6, "Hill")
    network = load_network(str(tmp_path / "net" / "net.toml"))
    (bored,) = network.track("m").tunnels
    assert (bored.end_m - bored.start_m, bored.name) == (300.0, "Hill")
    assert not network.track("w").tunnels


def test_a_path_has_the_values_of_its_direction(tmp_path: Path) -> None:
    line = imported(tmp_path, "--stops", "West,East")

    # The path is 1000 m of w, then m from its end; East is at 1.0 + 1.3 … 1.5 km of the system.
    assert (line.start_m, line.end_m) == (-200.0, 2400.0)
    west, east = line.stations
    assert (west.stop_m, east.platform_start_m, east.platform_end_m) == (0.0, 2100.0, 2300.0)
    assert east.stop_m == 2295.0
    assert east.side is PlatformSide.RIGHT
    assert [line.limit_mps(at_m) * 3.6 for at_m in (0.0, 900.0, 2100.0)] == [
        pytest.approx(kmh) for kmh in (72.0, 72.0, 36.0)
    ]
    assert line.limit_mps(1500.0) < 80 / 3.6  # that of the train, 72 km/h
    assert [line.gradient_permille(at_m) for at_m in (700.0, 900.0, 1500.0)] == [0.0, -10.0, 0.0]
    assert [line.radius_m(at_m) for at_m in (250.0, 400.0, 550.0)] == [None, 400.0, None]


def test_tracks_that_branch_become_a_network_with_routes(tmp_path: Path) -> None:
    assert main([str(written(tmp_path)), "--out", str(tmp_path)]) == 0
    network = load_network(str(tmp_path / "net.toml"))

    (switch,) = network.switches
    assert (switch.name, switch.tip, switch.left, switch.right) == (
        "S1",
        "w.end",
        "l.start",
        "m.end",
    )
    # The length of l is that of its track; ends without a switch are buffer stops.
    assert [track.end_m - track.start_m for track in network.tracks] == [1000.0, 1600.0, 1500.0]
    assert set(network.buffer_stops) == {"w.start", "m.start", "l.end"}
    assert [route.legs for route in network.routes] == [("w up", "m down"), ("m up", "w down")]
    config = load_config(str(tmp_path / "Two_params.toml"))
    for route in network.routes:
        assert implausible(config, load_line(f"{tmp_path / 'net.toml'}:{route.name}")) == []


def test_speeds_of_switch_branches_hold_from_the_switch_on(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        (
            '<leftBranch netRelationRef="wl"/>',
            '<leftBranch netRelationRef="wl" branchingSpeed="36" joiningSpeed="45" length="40"/>',
        ),
        (
            '<rightBranch netRelationRef="wm"/>',
            '<rightBranch netRelationRef="wm" joiningSpeed="54"/>',
        ),
    )
    assert main([str(path), "--out", str(tmp_path)]) == 0
    network = load_network(str(tmp_path / "net.toml"))

    left, right = network.track("l"), network.track("m")
    for running, kmh in ((Running.UP, 36.0), (Running.DOWN, 45.0)):
        first, second = left.limits_for(running)
        assert (first.start_m, first.end_m) == (0.0, 40.0)
        assert first.limit_mps * 3.6 == pytest.approx(kmh)
        assert second.limit_mps > first.limit_mps
    # 54 km/h serve both directions over the 30 m of a common turnout; 18 km/h is lower there.
    near = right.limits_for(Running.DOWN)[-1]
    assert near.end_m - near.start_m == 30.0
    assert near.limit_mps * 3.6 == pytest.approx(54.0)
    assert {limit.limit_mps for limit in right.limits_for(Running.UP)} == {5.0}


def test_a_speed_of_a_branch_that_is_not_positive_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old = '<leftBranch netRelationRef="wl"/>'
    path = written(tmp_path, (old, '<leftBranch netRelationRef="wl" branchingSpeed="0"/>'))

    assert main([str(path), "--out", str(tmp_path)]) == 2
    assert "branchingSpeed: '0' is not positive; write km/h" in capsys.readouterr().err


def test_a_track_for_one_direction_has_a_route_in_that_direction(tmp_path: Path) -> None:
    one_way = 'id="wm" positionOnA="1" positionOnB="1" navigability='
    path = written(tmp_path, (f'{one_way}"Both"', f'{one_way}"AB"'))

    assert main([str(path), "--out", str(tmp_path)]) == 0

    network = load_network(str(tmp_path / "net.toml"))
    assert len(network.switches) == 1
    assert [route.legs for route in network.routes] == [("w up", "m down")]


def test_the_train_is_the_formation(tmp_path: Path) -> None:
    imported(tmp_path, "--stops", "West,East")
    train = load_train(str(tmp_path / "out" / "Two.toml"))

    assert (train.mass_kg, train.length_m, len(train.cars)) == (90_000.0, 40.0, 2)
    # 1 m/s² of 90 t with 10 % more inertia is less than twice 60 kN.
    assert train.traction.rated_force_n == pytest.approx(99_000.0)
    assert train.traction.max_power_w == pytest.approx(1.2e6)
    assert train.brake.service.max_decel_mps2 == 0.9
    # 2000 N + 11 N/(m/s)² on 90 t of 9.81 m/s².
    assert train.resistance.c_n_per_kn_per_mps2 == pytest.approx(11.0 / 882.9, rel=1e-3)
    assert train.resistance.b_n_per_kn_per_mps == pytest.approx(0.0, abs=1e-6)


def test_a_train_stops_clear_of_the_end_of_the_track(tmp_path: Path) -> None:
    path = written(tmp_path, ('measure="2.5"', 'measure="2.6"'))

    line = line_along(read_infrastructure(read_xml(path)), ("West", "East"))
    assert main([str(path), "--out", str(tmp_path)]) == 0

    # The platform reaches the end of the path, 2400 m.
    assert line.stops[-1] == ("East", 2375.0)
    (edge,) = load_network(str(tmp_path / "net.toml")).track("m").platforms
    # The chainage of m falls along it, so the network counts from its begin.
    assert (edge.start_m, edge.stop_down_m, edge.stop_up_m) == (0.0, 25.0, 295.0)


def test_a_platform_off_its_track_is_left_out_and_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, ('measure="2.3"', 'measure="0.3"'))

    assert main([str(path), "--out", str(tmp_path)]) == 0

    assert "left out: linearLocation 'pl'" in (text := capsys.readouterr().out)
    assert "measure '0.3' is not on netElement 'm', from 2600 m to 1000 m" in text
    assert load_network(str(tmp_path / "net.toml")).track("m").platforms == ()


def test_a_platform_without_ends_is_laid_out_by_rule(tmp_path: Path) -> None:
    before, _, rest = TRACKS.partition("<linearCoordinateBegin")
    after = rest.partition('measure="2.3"/>')[2]
    path = tmp_path / "net.railml"
    path.write_text(before + after, encoding="utf-8")

    assert main([str(path), "--stops", "West,East", "--out", str(tmp_path)]) == 0

    east = load_line(str(tmp_path / "net.toml")).stations[-1]
    # The middle of m is 800 m behind the end of w; the train is 40 m long.
    assert (east.stop_m, east.platform_start_m, east.platform_end_m) == (1600.0, 1555.0, 1605.0)


def test_every_filled_gap_is_listed(tmp_path: Path) -> None:
    imported(tmp_path, "--stops", "West,East")
    text = (tmp_path / "out" / "net.toml").read_text(encoding="utf-8")

    for rule in ("# - platforms: West reaches 5 m", "# - stopping points:", "# - tags:"):
        assert rule in text
    assert "# - track ends: taken for buffer stops: m begin, l end" in text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ((' units="km"', ""), "linearPositioningSystem 'km': has no 'units'; write units"),
        ((' units="km"', ' units="mi"'), "'km': units: 'mi' is unknown; convert the measures"),
        (('id="m">', 'id="w">'), "netElement 'w': is there twice, two tracks at one place"),
        (('length="1000"', 'length="0"'), "netElement 'w': length 0 m is not positive"),
        (('length="1000"', 'length="long"'), "netElement 'w': length: 'long' is not a finite"),
        (('value="1500"', 'value="0"'), "netElement 'l': has no length; give it 'length'"),
        (
            ('positionOnA="1" positionOnB="0" navigability="None"', 'navigability="Both"'),
            "netRelation 'ml': positionOnA: None is not 0 or 1",
        ),
        (
            (
                '<netRelation id="ml" positionOnA="1" positionOnB="0" navigability="None">',
                '<netRelation id="ml" positionOnA="1" positionOnB="0" navigability="Some">',
            ),
            "netRelation 'ml': navigability: 'some' is none of",
        ),
        (
            (
                '<netRelation id="ml" positionOnA="1" positionOnB="0" navigability="None">'
                '\n    <elementA ref="m"/>',
                '<netRelation id="ml" positionOnA="1" positionOnB="0">\n    <elementA ref="w"/>',
            ),
            "netRelation 'ml': joins the same ends as netRelation 'wl'; remove one",
        ),
        (('elementB ref="m"', 'elementB ref="mm"'), "there is no netElement 'mm'; nearest valid"),
        (
            ('id="bl" netElementRef="w"', 'id="bl" netElementRef="x"'),
            "spotLocation 'bl': netElementRef: there is no netElement 'x'",
        ),
        (
            ('posEnd="1600"', 'posEnd="1700"'),
            "posEnd 1700 m is not on netElement 'm', which is 1600",
        ),
        (('maxSpeed="36"', 'maxSpeed="-36"'), "speedSection 'v2': maxSpeed: '-36' is not positive"),
        (('lateralSide="left"', 'lateralSide="port"'), "lateralSide: 'port' is none of left"),
        (('version="3.2"', 'version="2.4"'), "railML: version '2.4' is not 3.x; convert"),
        (("<common", "<common <"), "not XML: not well-formed"),
        (("<railML", "<!DOCTYPE railML><railML"), "has a DOCTYPE, which railML has not"),
        (('vehicleRef="v"/><trainOrder', 'vehicleRef="u"/><trainOrder'), "no vehicle 'u'"),
        (('xValueUnit="km/h"', 'xValueUnit="mph"'), "xValueUnit: 'mph' is unknown here"),
        (('bruttoWeight="45" ', ""), "vehicle 'v': has no 'bruttoWeight'; give it, or"),
    ],
)
def test_a_bad_file_names_file_and_element(
    change: tuple[str, str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, change)

    assert main([str(path), "--out", str(tmp_path / "out")]) == 2

    error = capsys.readouterr().err
    assert error.startswith(f"vobc import: {path}: ")
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_gap_in_the_topology_is_named(tmp_path: Path) -> None:
    path = written(tmp_path, ('id="wm" positionOnA="1"', 'id="wm" positionOnA="0"'))

    with pytest.raises(SettingsError, match="netElements: no path leads through West, East, West"):
        line_along(read_infrastructure(read_xml(path)), ("West", "East", "West"))


def test_a_junction_of_four_needs_chosen_stops(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    double = '<netRelation id="ml" positionOnA="1" positionOnB="0" navigability="None">'
    path = written(tmp_path, (double, double.replace("None", "Both")))

    assert main([str(path), "--out", str(tmp_path)]) == 2
    assert "netRelations: a junction is no simple switch" in capsys.readouterr().err
    assert main([str(path), "--stops", "West,East", "--out", str(tmp_path)]) == 0


def test_one_of_several_formations_is_chosen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = '<formation id="g" speed="50"><designator register="r" entry="One"/>'
    other += '<trainOrder orderNumber="1" vehicleRef="v"/></formation></formations>'
    path = written(tmp_path, ("</formations>", other))

    assert main([str(path), "--out", str(tmp_path)]) == 2
    assert "2 formations; choose one with --formation: Two, One" in capsys.readouterr().err
    assert main([str(path), "--formation", "Tow", "--out", str(tmp_path)]) == 2
    assert "has no formation 'Tow'; nearest valid formation: Two" in capsys.readouterr().err
    assert main([str(path), "--formation", "One", "--out", str(tmp_path)]) == 0
    assert load_train(str(tmp_path / "One.toml")).mass_kg == 45_000.0
