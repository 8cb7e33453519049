"""`canlog plot`: which signals it draws, where lines break, and that it loses no peak."""

from pathlib import Path
from xml.etree import ElementTree

import matplotlib.image
import numpy as np
import pytest

from canlog.command import main
from canlog.damage import LogError
from canlog.reader import Log, read
from canlog.rows import from_rows
from canlog.views.happenings import happenings
from canlog.views.place import at_instants, journey_of
from canlog.views.plot import Picture, draw
from canlog.views.span import TimeSpan, date_text
from canlog.views.traces import (
    SignalTrace,
    default_words,
    find_names,
    flags_text,
    panels_of,
    trace_of,
)
from hil_tests.unit.canlog import canlog_rig as rig

MS = 1_000_000


@pytest.fixture(scope="module")
def log() -> Log:
    return Log(Path("random.log"), rig.random_frames(4_000), rig.bus())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a run folder with what pictures need: a train that runs at 10 m/s for 20 s."""
    frames = rig.log_of([(n * 100 * MS, 0x100, bytes(6)) for n in range(200)]).frames
    rig.write_candump(tmp_path / "bus.log", frames)
    rows = [f"{n / 20:.3f},{n / 2:.3f},10.0,locked\n" for n in range(401)]
    (tmp_path / "truth.csv").write_text("t_s,front_m,speed_mps,door_left\n" + "".join(rows))
    (tmp_path / "events.jsonl").write_text(
        '{"t_s": 5.0, "number": 1, "kind": "EMERGENCY_APPLIED", "words": "too fast", "value": 1,'
        ' "sources": [{"source": "TACHO", "id": 389, "payload": "00ff", "heard_s": 4.99}]}\n'
        '{"t_s": 7.0, "number": 2, "kind": "TAG_AC'
    )
    (tmp_path / "run.toml").write_text(
        "[line]\nspeed_sections = [{ start_m = 0.0, end_m = 500.0, limit_mps = 15.0 }]\n"
        'tags = [{ tag_id = 1, position_m = 190.0, kind = "stop", station = "East" }]\n'
    )
    return tmp_path


def test_a_signal_is_found_by_full_name_alone_or_by_pattern(log: Log) -> None:
    assert find_names(log, "PLAIN.state") == ["PLAIN.state"]
    assert find_names(log, "crooked") == ["ODD.crooked"]
    assert find_names(log, "FLOATS.*") == ["FLOATS.single", "FLOATS.other"]
    panels = panels_of(log, ["small,PLAIN.state", "double"])
    assert [[each.name for each in panel] for panel in panels] == [
        ["PLAIN.small", "PLAIN.state"],
        ["DOUBLE.double"],
    ]


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ("whole", "WIDE.whole, WIDE_SIGNED.whole"),
        ("PLAIN.stat", "no signal stat"),
        ("crookd", "did you mean ODD.crooked"),
        ("NOTHING.*", "no such signal"),
    ],
)
def test_what_is_no_signal_is_told_with_what_is_near(log: Log, asked: str, says: str) -> None:
    with pytest.raises(LogError, match=says.replace("*", r"\*")):
        find_names(log, asked)


def test_frames_that_do_not_carry_a_signal_make_no_sample() -> None:
    rows = [(n * MS, rig.EXTENDED_ID, 1, "can0", bytes([n % 3, n, 0, 0, 0, 0])) for n in range(30)]
    log = Log(Path("x.log"), from_rows(rows), rig.bus())

    trace = trace_of(log, "CHOSEN.first")

    assert trace.values.tolist() == list(range(0, 30, 3))
    assert trace.at_ns.tolist() == [n * MS for n in range(0, 30, 3)]


def test_a_sum_of_flags_is_told_by_its_flags() -> None:
    choices = {0.0: "NONE", 1.0: "DOORS", 2.0: "BRAKE", 4.0: "FIRE"}

    assert flags_text(choices, 5) == "DOORS|FIRE"
    assert flags_text(choices, 8) == ""
    assert flags_text({0.0: "OFF", 1.0: "ON", 3.0: "BOTH"}, 4) == ""


def test_one_sample_of_a_million_is_to_be_seen(tmp_path: Path) -> None:
    """In a picture 1,400 pixels wide, the peak must colour pixels in the upper half of the
    panel.
    """
    pictures = []
    for peak in (0.0, 5.0):
        values = np.tile([0.0, 1.0], 500_000)
        values[123_456] = peak
        # Give both pictures the same scale.
        values[[0, -1]] = 5.0
        trace = SignalTrace("x", "V", np.arange(1_000_000, dtype=np.int64) * MS, values)
        path = tmp_path / f"{peak}.png"
        drawn = draw(Picture("", [[trace]], TimeSpan(0, 0, 10**12)), path)
        assert drawn < 8_000
        pictures.append(matplotlib.image.imread(path))

    differing = np.argwhere((pictures[0] != pictures[1]).any(axis=2))

    height, width = pictures[0].shape[:2]
    assert len(differing) > 20
    # The picture spans a thousand seconds; only pixels at the peak may differ.
    assert np.ptp(differing[:, 1]) <= 6
    assert differing[:, 0].min() < height / 2
    assert differing[:, 1].min() < 0.2 * width


def test_the_same_picture_is_the_same_file(tmp_path: Path) -> None:
    few = Log(Path("few.log"), rig.random_frames(400), rig.bus())
    panels = panels_of(few, ["small,state", "double"])

    for suffix in (".png", ".svg"):
        files = [tmp_path / f"{n}{suffix}" for n in range(2)]
        for path in files:
            draw(Picture("t", panels, TimeSpan(0, few.start_ns, few.end_ns)), path)
        assert files[0].read_bytes() == files[1].read_bytes()


def test_the_command_draws_over_time_and_over_distance(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    svg = tmp_path / "x.svg"

    assert main(["plot", str(folder), "truth.speed_mps", "-o", str(svg), "--x", "distance"]) == 0

    assert "1 panels, 401 samples" in capsys.readouterr().out
    root = ElementTree.parse(svg).getroot()  # noqa: S314
    assert root.tag.endswith("svg")
    assert main(["plot", str(folder), "nothing", "-o", str(svg)]) == 2
    assert main(["plot", str(folder), "-o", "x.pdf"]) == 2
    assert main(["plot", str(folder), "-o", str(svg), "--from", "99", "--to", "100"]) == 2
    errors = capsys.readouterr().err
    assert "-o x.pdf: must end in .png or .svg" in errors
    assert "Traceback" not in errors


def test_place_is_straight_between_its_samples_and_unknown_outside() -> None:
    place = SignalTrace("m", "m", np.array([0, 10, 20], np.int64), np.array([0.0, 100.0, 120.0]))
    asked = np.array([-1, 0, 5, 15, 20, 21], np.int64)

    np.testing.assert_array_equal(at_instants(place, asked), [np.nan, 0, 50, 110, 120, np.nan])
    np.testing.assert_array_equal(at_instants(place, asked, hold=True), [0, 0, 50, 110, 120, 120])


def test_a_run_folder_tells_journey_and_events(folder: Path) -> None:
    log = read(folder)

    journey = journey_of(log)
    (event,) = happenings(log)

    assert journey is not None
    (curve,) = journey.curves
    assert (curve.role, curve.name) == ("truth", "truth.speed_mps")
    assert curve.place_m[-1] == pytest.approx(200.0)
    assert journey.line.stations == (("East", 190.0),)
    assert journey.line.limits == ((0.0, 500.0, 15.0),)
    assert log.run is not None
    assert (event.at_ns - log.run.start_ns, event.weight) == (5_000 * MS, 2)
    assert event.basis[0].payload == "00ff"
    assert default_words(log) != []


def test_a_dated_log_tells_its_date_and_others_do_not() -> None:
    assert date_text(1_700_000_000_123_456_789) == "2023-11-14 22:13:20.123456789 UTC"
    assert date_text(5_000_000_000) == ""


def test_truth_of_a_plant_process_counts_from_its_first_frame(tmp_path: Path) -> None:
    """The plant starts four seconds before the controller; both count from their own start."""
    first_s, lines = 1_700_000_000, []
    for k in range(80):
        lines.append(f"({first_s + k * 0.1:.6f}) vcan0 185#0011223344556677")
        if k >= 40:
            lines.append(f"({first_s + k * 0.1 + 0.01:.6f}) vcan0 101#E8530047C6")
    (tmp_path / "bus.log").write_text("\n".join(lines) + "\n")
    (tmp_path / "truth.csv").write_text("t_s,front_m\n0.0,10.0\n6.0,20.0\n")
    (tmp_path / "cycles.csv").write_text("t_s,front_m\n0.0,15.0\n")

    apart = trace_of(read(tmp_path), "truth.front_m")
    (tmp_path / "plant.json").write_text("{}")
    log = read(tmp_path)

    own = trace_of(log, "cycles.front_m")
    beside = trace_of(log, "truth.front_m")
    assert (own.at_ns[0] - first_s * 10**9) / 1e9 == pytest.approx(4.01)
    assert (apart.at_ns[0] - first_s * 10**9) / 1e9 == pytest.approx(4.01)
    assert [(at - first_s * 10**9) / 1e9 for at in beside.at_ns] == pytest.approx([0.0, 6.0])
