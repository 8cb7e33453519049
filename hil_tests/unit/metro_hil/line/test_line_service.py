"""The programs of a line that a user brings up: their commands, their process ids, their end."""

import os
import signal
from pathlib import Path

import msgspec
import pytest

from firmware_py.buses.hub_control import hub_status
from firmware_py.buses.interfaces import BUS_NAME
from firmware_py.clock.clock import WallClock
from metro_hil.cli.vobc import main
from metro_hil.line.exercise.plan import PlannedRun
from metro_hil.line.service.command import NOTE
from metro_hil.line.service.plan import (
    LineProgram,
    LineSetup,
    LineUp,
    bus_name,
    chosen,
    programs_of,
)
from metro_hil.line.service.programs import ProgramFiles, end_all
from metro_hil.model.run_options import EXIT_USAGE, parse
from plant_emulator.cli.options import parser as plant_parser
from vobc.cli.options import parser as vobc_parser

WAYS = [PlannedRun("S6", "S8"), PlannedRun("S5", "S7")]
SETUP = LineSetup("loop", "tcp/127.0.0.1:7500", "B", 3, 40, WAYS, "/secure")


def test_every_program_understands_its_command(tmp_path: Path) -> None:
    parsers = {"plant_emulator": plant_parser(), "vobc": vobc_parser()}

    for program in programs_of(SETUP, tmp_path):
        if program.module in parsers:
            words = [*program.arguments, *(["--out", "x"] if program.logs else [])]
            words = words[1:] if program.module == "vobc" else words
            parsed = parsers[program.module].parse_args(words)
            assert (parsed.line, parsed.line_radio) == ("loop", "tcp/127.0.0.1:7500")
            assert parsed.secure == "/secure"


def test_the_plant_of_an_attended_train_has_no_desk_of_its_own(tmp_path: Path) -> None:
    setup = msgspec.structs.replace(SETUP, attended=[2])

    plants = [each for each in programs_of(setup, tmp_path) if each.name.endswith("/plant")]

    assert ["external" in each.arguments for each in plants] == [False, True]


def test_wayside_buses_and_plants_start_before_the_controllers(tmp_path: Path) -> None:
    names = [each.name for each in programs_of(SETUP, tmp_path)]

    assert names == [
        *("router", "arbiter1", "arbiter2", "arbiter3", "track", "T1/bus", "T2/bus"),
        *("T1/plant", "T2/plant", "T1/controller", "T2/controller"),
    ]


def test_buses_of_two_run_folders_have_different_valid_names(tmp_path: Path) -> None:
    names = [bus_name(tmp_path / run, train) for run in ("one", "two") for train in (1, 99)]

    assert len({*names}) == 4
    assert all(BUS_NAME.fullmatch(name) for name in names)


def test_the_name_of_a_train_means_its_controller(tmp_path: Path) -> None:
    programs = programs_of(SETUP, tmp_path)

    assert chosen(programs, "T2") is programs[-1]
    assert chosen(programs, "T2/plant") is programs[-3]
    assert chosen(programs, "T3") is None


def test_a_program_is_found_by_its_process_id_until_it_is_ended(tmp_path: Path) -> None:
    name, clock = f"s{os.getpid()}", WallClock()
    files = ProgramFiles(tmp_path, LineProgram("T1/bus", "firmware_py.buses.hub", [name]))
    files.start()
    pid = files.pid()
    assert pid is not None
    end_ns = clock.now_ns() + 20_000_000_000
    while hub_status(name) is None and clock.now_ns() < end_ns:
        clock.wait_until(clock.now_ns() + 10_000_000)
    # A stopped program is ended, too.
    os.kill(pid, signal.SIGSTOP)

    assert end_all([files], clock) == 1
    assert files.pid() is None
    assert end_all([files], clock) == 0
    assert hub_status(name) is None


def test_another_process_with_the_same_number_is_not_the_program(tmp_path: Path) -> None:
    files = ProgramFiles(tmp_path, LineProgram("wayside", "plant_emulator", []))
    (tmp_path / "wayside.pid").write_text(f"{os.getpid()} 1\n")

    assert files.pid() is None
    assert end_all([files], WallClock()) == 0


@pytest.mark.parametrize("note", ["", "12", "x 3", "-1 1", "0 0"])
def test_a_damaged_process_id_file_means_that_the_program_does_not_run(
    note: str, tmp_path: Path
) -> None:
    (tmp_path / "wayside.pid").write_text(note)

    assert ProgramFiles(tmp_path, LineProgram("wayside", "plant_emulator", [])).pid() is None


@pytest.mark.parametrize(
    ("words", "code", "line"),
    [
        (["down"], 3, "vobc: no line is up below {here}/runs; `vobc line up` brings one up"),
        (["status", "--out", "x"], 2, "vobc: x/line-up.json: not the file of a line that"),
        (["up", "--trains", "99"], 2, "vobc: --trains 99: the line loop has room for 1 to 8"),
        (["up", "--line-radio", "7448"], 2, "vobc: --line-radio 7448: not an endpoint"),
        (["up", "--secure", "none"], 2, "vobc: none/ca.pem: cannot be read"),
    ],
)
def test_a_mistake_gives_one_line(
    words: list[str],
    code: int,
    line: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)

    assert main(["line", *words]) == code

    said = capsys.readouterr().err
    assert said.startswith(line.format(here=tmp_path))
    assert len(said.splitlines()) == 1
    assert not list(tmp_path.glob("runs/*"))


def test_a_second_line_of_the_same_name_or_endpoint_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    run = tmp_path / "runs" / "first"
    run.mkdir(parents=True)
    program = LineProgram("wayside", "plant_emulator", [])
    up = LineUp("other", "tcp/127.0.0.1:7448", [program])
    (run / NOTE).write_bytes(msgspec.json.encode(up))
    # This very process stands for the wayside.
    started = Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19]
    (run / "wayside.pid").write_text(f"{os.getpid()} {started}\n")

    assert main(["line", "up"]) == 3

    assert "line other is up already at tcp/127.0.0.1:7448" in capsys.readouterr().err
    assert main(["line", "status"]) == 0
    assert f"running, process {os.getpid()}" in capsys.readouterr().out
    assert main(["line", "restart", "waysid"]) == 2
    assert "did you mean wayside?" in capsys.readouterr().err


def test_trains_of_a_service_are_one_program_each_beside_a_wayside_with_routes(
    tmp_path: Path,
) -> None:
    setup = msgspec.structs.replace(
        SETUP, secure=None, ways=[], service="shuttle.toml", routes=["out", "back"], trains=2
    )
    programs = programs_of(setup, tmp_path)

    *wayside, first, second = programs
    assert [each.name for each in wayside] == [
        "router",
        "arbiter1",
        "arbiter2",
        "arbiter3",
        "track",
    ]
    for each in wayside:
        assert plant_parser().parse_args(each.arguments).routes == ("out", "back")
    options = parse(second.arguments)
    assert (options.is_networked, options.train, options.trains) == (True, 2, 2)
    assert (options.line_timers, options.arbiters) == ("B", 3)
    assert chosen(programs, "T1") is first


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--line", "loop"], "--line: not with --service"),
        (["--secure", "x"], "x/ca.pem: cannot be read"),
        (["--attended", "T1"], "--attended: not with --service"),
        (["--trains", "21"], "--trains 21: with a service there are 1 to 20"),
    ],
)
def test_options_that_do_not_fit_a_service_are_refused(
    words: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    up = ["line", "up", "--service", "docs/examples/line/shuttle.toml"]

    assert main([*up, *words]) == EXIT_USAGE

    assert text in capsys.readouterr().err
