"""The command `canlog`: its output, counts, conversions, replays, and error messages."""

import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from can_dbc.codec import Encoder
from can_dbc.nodes import Direction
from can_dbc.traction import TractionCommand
from canlog import read
from canlog.command import VERBS, main
from canlog.damage import Damages
from canlog.formats import candump
from canlog.frames import EXTENDED, Frames
from canlog.rows import from_rows
from canlog.verbs.replay import Player
from firmware_py.clock.clock import LockstepClock
from firmware_py.ports import CanFrame, LinkCounters

MS = 1_000_000


def traction_log(cycles: int = 20) -> Frames:
    """Return vital pairs every 50 ms with a rising force; the sixth first half is damaged."""
    encoder, rows = Encoder(), []
    for cycle in range(cycles):
        way = Direction.FORWARD if cycle % 2 else Direction.REVERSE
        for place, (can_id, data) in enumerate(
            encoder.encode(TractionCommand(1000.0 * cycle, way, True))
        ):
            data = data[:-1] + b"\x00" if (cycle, place) == (5, 0) else data
            rows.append((cycle * 50 * MS + place * 400_000, can_id, 0, "vcan0", data))
    return from_rows(rows)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "x.log"
    candump.write(path, [traction_log()], Damages())
    return path


TORN = "1 x torn line of events.jsonl at line 2"


def out(capsys: pytest.CaptureFixture[str], *words: object, warned: str = "") -> list[str]:
    code = main([str(word) for word in words])
    told = capsys.readouterr()
    assert code == 0
    assert told.err.startswith(f"canlog: warning: {warned}") if warned else not told.err, told.err
    return told.out.splitlines()


def error(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    assert main([str(word) for word in words]) == 2
    return capsys.readouterr().err


def test_show_decodes_frame_by_frame(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = out(capsys, "show", log)

    assert len(lines) == 40
    assert lines[2].split()[:4] == ["0.050000000", "vcan0", "103", "TRACTION_CMD"]
    assert lines[2].endswith("  force_n 1000 N, direction FORWARD, traction_permitted TRUE")


def test_show_tells_which_frames_are_rejected_and_why(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = out(capsys, "show", log, "--rejected")

    assert len(lines) == 2
    assert "REJECTED wrong crc: CRC is" in lines[0]
    assert "REJECTED twin mismatch" in lines[1]


def test_show_chooses_by_name_identifier_node_and_value(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert len(out(capsys, "show", log, "--message", "TRACTION_CMD")) == 20
    assert len(out(capsys, "show", log, "--message", "*_INV", "--limit", 3)) == 3
    assert len(out(capsys, "show", log, "--id", "0x104")) == 20
    assert len(out(capsys, "show", log, "--node", "VOBC")) == 40
    assert len(out(capsys, "show", log, "--node", "TCU")) == 0
    chosen = out(
        capsys, "show", log, "--message", "TRACTION_CMD",
        "--where", "force_n >= 10000 and direction == FORWARD or force_n < 1000",
    )  # fmt: skip
    assert len(chosen) == 5 + 1


def test_show_chooses_by_time_rate_and_change(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert len(out(capsys, "show", log, "--from", 0.1, "--to", 0.2)) == 2 * 3 - 1
    assert len(out(capsys, "show", log, "--rate", 5)) == 2 * 5
    assert len(out(capsys, "show", log, "--changed")) == 40


def test_show_marks_the_bits_that_changed(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = out(capsys, "show", log, "--message", "TRACTION_CMD", "--bits", "--limit", 2)

    first = traction_log().payload(0)
    assert lines[1].split() == [f"{byte:08b}" for byte in first]
    assert lines[3].split() != lines[1].split()
    flips = [a != b for a, b in zip(lines[1][17:], lines[3][17:], strict=True)]
    assert [mark == "^" for mark in lines[4][17:].ljust(len(flips))] == flips


def test_show_is_coloured_only_where_it_is_wanted(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "\x1b[" not in out(capsys, "show", log)[0]
    assert "\x1b[" in out(capsys, "show", log, "--color", "always")[0]


def run_folder(folder: Path) -> Path:
    """Write a run of two cycles in which the controller receives 183 and sends 103 and 104."""
    frames = traction_log(2)
    received = [(at, 0x183, 0, "vcan0", bytes(7)) for at in (20 * MS, 40 * MS, 70 * MS)]
    rows = [(int(frames.at_ns[i]) + 300_000, int(frames.identifier[i]), 0, "vcan0",
             frames.payload(i)) for i in range(len(frames))]  # fmt: skip
    folder.mkdir()
    candump.write(folder / "bus.log", [from_rows(sorted([*received, *rows]))], Damages())
    told = {"told": {"start_ns": 0}}
    sent = [f"tx can {row[1]:03X} {row[4].hex().upper()}\n" for row in rows]
    taken = [f"rx can {row[0]} 183 {row[4].hex().upper()}\n" for row in received]
    (folder / "ports.log").write_text(
        f"start {json.dumps(told)}\nrun control 0 0\n{''.join(sent[:2])}"
        f"run control 50000000 0\n{''.join(taken[:2])}{''.join(sent[2:])}end 9\n"
    )
    (folder / "cycles.csv").write_text("t_s,speed_mps\n0,1.5\n0.05,\n")
    (folder / "events.jsonl").write_text(
        '{"t_s": 0.05, "kind": "EMERGENCY_APPLIED", "words": "too fast"}\n{"t_s": 0.'
    )
    return folder


def test_a_run_names_the_cycle_that_each_frame_fed_or_came_from(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = read(run_folder(tmp_path / "run"))
    assert log.run is not None

    assert log.run.cycle_of.tolist() == [0, 0, 1, 1, 1, 1, -1]
    assert log.run.sent.tolist() == [True, True, False, False, True, True, False]
    assert log.run.cycle_ns.tolist() == [0, 50 * MS]
    assert log.run.cycles["speed_mps"][0] == 1.5
    assert np.isnan(log.run.cycles["speed_mps"][1])
    assert [each.kind for each in log.warnings] == ["torn line of events.jsonl"]
    lines = out(capsys, "show", tmp_path / "run", warned=TORN)
    assert [line.split()[4:6] for line in lines[:3]] == [["from", "0"], ["from", "0"], ["to", "1"]]


def test_without_the_record_of_ports_the_stamps_tell_the_cycles(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "run")
    exact = read(folder).run
    (folder / "ports.log").unlink()
    guessed = read(folder).run

    assert exact is not None
    assert guessed is not None
    assert (exact.exact, guessed.exact) == (True, False)
    assert guessed.cycle_of.tolist() == exact.cycle_of.tolist()


def test_show_finds_what_was_around_an_event(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = run_folder(tmp_path / "run")

    words = ("--around", "emergency", "--within", 0.015)
    lines = out(capsys, "show", folder, *words, warned=TORN)

    assert [line.split()[3] for line in lines] == [
        *("TRACTION_STATUS", "TRACTION_CMD", "TRACTION_CMD_INV"),
    ]
    assert "no such event; the run has EMERGENCY_APPLIED" in error(
        capsys, "show", folder, "--around", "fire"
    )


def test_stats_are_told_in_every_form(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = json.loads("\n".join(out(capsys, "stats", log, "--as", "json")))
    rows = {row["message"]: row for row in told["messages"]}
    assert rows["TRACTION_CMD"]["crc_errors"] == 1
    assert rows["TRACTION_CMD"]["gap_ms_max"] == 50.0
    table = out(capsys, "stats", log, "--as", "csv")
    assert table[0].startswith("channel,id,message,known,frames")
    assert len(table) == 3
    assert any("TRACTION_CMD_INV" in line for line in out(capsys, "stats", log, "--signals"))


def test_a_rule_that_breaks_is_an_exit_code_and_a_failed_case(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["stats", str(log), "--fail-on", "crc_errors > 1"]) == 0
    capsys.readouterr()

    code = main(
        ["stats", str(log), "--as", "junit", "--fail-on", "crc_errors > 0", "--fail-on", "lost > 9"]
    )
    suite = ElementTree.fromstring(capsys.readouterr().out)  # noqa: S314

    assert code == 1
    assert suite.attrib["failures"] == "1"
    (failure,) = suite.iter("failure")
    assert "TRACTION_CMD on vcan0: crc_errors 1" in failure.attrib["message"]


def test_convert_lists_what_is_lost(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = log.with_suffix(".blf")

    assert main(["convert", str(log), str(target)]) == 0

    assert "lost: 1 x channel name: vcan0 becomes channel 1" in capsys.readouterr().err
    assert read(target).frames.at_ns.tolist() == traction_log().at_ns.tolist()
    assert main(["convert", str(log), str(target), "--force", "--strict"]) == 1


@pytest.mark.parametrize("form", ["parquet", "csv", "npz", "arrow"])
def test_extract_writes_a_table_for_each_message(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], form: str
) -> None:
    lines = out(capsys, "extract", log, "-o", tmp_path / "tables", "--as", form)

    path = tmp_path / "tables" / f"TRACTION_CMD.{form}"
    assert lines[0] == f"{path}: 20 rows"
    if form == "parquet":
        table = pyarrow.parquet.read_table(path)
        assert table.column("force_n").to_pylist() == [1000 * n for n in range(20)]
        assert table.column("at_ns").to_pylist()[1] == 50 * MS
        assert table.schema.field("force_n").metadata[b"unit"] == b"N"
    if form == "npz":
        assert np.load(path)["force_n"].tolist() == [1000 * n for n in range(20)]


class Paper:
    """A port that records what is sent and when."""

    def __init__(self) -> None:
        self.sent: list[tuple[int, int, bytes]] = []
        self.counters = LinkCounters()

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        self.sent.append((now_ns, can_id, data))

    def receive(self, now_ns: int) -> list[CanFrame]:
        del now_ns
        return []

    def close(self) -> None:
        pass


@pytest.mark.parametrize(("speed", "gap_ns"), [(1.0, 50 * MS), (2.0, 25 * MS)])
def test_replay_keeps_the_times_of_the_log(speed: float, gap_ns: int) -> None:
    frames = traction_log(3)
    port, clock = Paper(), LockstepClock(start_ns=7_000)
    player = Player(port, clock, speed)

    player.play(frames[:3])
    player.play(frames[3:])

    assert [at for at, _, _ in port.sent][::2] == [7_000 + gap_ns * n for n in range(3)]
    assert [data for _, _, data in port.sent] == [frames.payload(n) for n in range(6)]
    assert player.late_ns_max == 0


def test_replay_leaves_out_what_the_bus_of_the_train_does_not_carry() -> None:
    frames = from_rows([(0, 1, EXTENDED, "c", b""), (1, 2, 0, "c", b"")])
    player = Player(Paper(), LockstepClock())

    player.play(frames)

    assert (player.sent, player.unsent) == (1, 1)


def test_a_live_bus_is_shown_until_somebody_interrupts(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = traction_log(2)
    heard = [
        CanFrame(int(frames.at_ns[at]), int(frames.identifier[at]), frames.payload(at))
        for at in range(4)
    ]

    class Live(Paper):
        def receive(self, now_ns: int) -> list[CanFrame]:
            if not heard:
                raise KeyboardInterrupt
            return [heard.pop(0)]

    monkeypatch.setattr("firmware_py.buses.open_can", lambda *_, **__: Live())

    with pytest.raises(KeyboardInterrupt):
        main(["show", "--follow", "embedded:x", "--message", "TRACTION_CMD"])

    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1:4] for line in lines] == [["x", "103", "TRACTION_CMD"]] * 2
    assert "direction FORWARD" in lines[1]


def test_mistakes_are_told_in_a_line(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "absent.log: cannot be read: No such file" in error(capsys, "stats", "absent.log")
    live = ("show", str(log), "--follow", "socketcan:vcan0")
    assert "and --follow socketcan:vcan0 exclude each other" in error(capsys, *live)
    assert "--node TCX: the DBC file has" in error(capsys, "show", log, "--node", "TCX")
    assert "no message of can_dbc matches" in error(capsys, "show", log, "--message", "X")
    assert "unknown signal force; nearest" in error(capsys, "show", log, "--where", "force > 1")
    assert "direction has no value AUTO" in error(
        capsys, "show", log, "--where", "direction == AUTO"
    )
    for text in ("zz", "-1", "+1", "1_0", " 1", "1xx", "x", ""):
        assert f"{text}: no identifier" in error(capsys, "show", log, f"--id={text}")
    assert "20000000: no identifier has more" in error(capsys, "show", log, "--id", "20000000")
    assert "is no run folder" in error(capsys, "show", log, "--around", "x")
    long = f"{'x' * 300}.asc"
    assert f"canlog: {long}: File name too long" in error(capsys, "convert", log, long)
    assert "--speed 0.0: has to be positive" in error(
        capsys, "replay", log, "--bus", "embedded:v", "--speed", 0
    )
    assert "unknown kind; nearest valid" in error(capsys, "replay", log, "--bus", "embeded:v")


def test_every_verb_says_what_it_is_for(capsys: pytest.CaptureFixture[str]) -> None:
    for verb in VERBS:
        with pytest.raises(SystemExit) as ended:
            main([verb, "--help"])
        assert ended.value.code == 0
        assert "usage: canlog" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("show", "--from", "nan"), "'nan' is no number of seconds of a log"),
        (("show", "--to", "1e300"), "'1e300' is no number of seconds of a log"),
        (("show", "--limit", "-1"), "'-1' is no whole number from 0 on"),
        (("show", "--utc-offset-s", "1e3"), "'1e3' is no offset within a day"),
        (("plot", "--from", "x"), "'x' is no number of seconds of a log"),
        (("stats", "--baudrate", "-5"), "'-5' is no whole number from 0 on"),
        (("stats", "--baudrate", "1000000000001"), "1000000000001 is more than 1000000000000"),
        (("show", "--limit", 20 * "9"), "99999999999999999999 is more than 1000000000000"),
    ],
)
def test_numbers_that_are_none_are_refused(
    log: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: str
) -> None:
    with pytest.raises(SystemExit) as left:
        main([words[0], str(log), *words[1:]])

    assert left.value.code == 2
    assert said in capsys.readouterr().err


def test_a_span_without_an_instant_and_a_port_that_is_none_are_refused(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "nothing lies between" in error(capsys, "show", log, "--from", 5, "--to", 1)
    for port in (-4, 99_999):
        said = error(capsys, "open", log, "--no-browser", "--port", port)
        assert f"--port {port}: has to be from 0 to 65535" in said


def test_a_text_that_no_line_of_is_a_frame_is_no_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "README.md"
    path.write_text("# A headline\n\nSee issue #12 [1] and (1.5) other things.\n", encoding="utf-8")

    assert "of no known format" in error(capsys, "stats", path)
    path.with_suffix(".log").write_text("junk#\n", encoding="utf-8")
    said = error(capsys, "stats", path.with_suffix(".log"))
    assert "README.log: holds no frame (read as candump); it looks like text that begins" in said
