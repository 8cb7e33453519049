"""The options of `vobc run` about desk and wires: valid combinations, and which program gets
them."""

from pathlib import Path

import pytest

from can_dbc.cab import CabMode
from can_dbc.vobc import (
    AtoPhase,
    Cause,
    Inhibit,
    Missing,
    OperatingMode,
    Supervision,
    VobcMode,
    VobcStatus,
    Withheld,
)
from firmware_py.buses.interfaces import BUS_NAME
from metro_hil.cli.realtime_run import (
    controller_line_arguments,
    hints_of,
    line_arguments,
    memory_arguments,
    own_bus_name,
)
from metro_hil.model.run_options import parse
from metro_hil.realtime.live_display import BusPicture
from metro_hil.run.lockstep import scenario_of
from plant_emulator.cli.options import parser as plant_parser
from vobc.cli import parser as vobc_parser
from zenoh_config.sessions import LINE_ENDPOINT


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--lockstep", "--desk", "external"], "`plant desk` cannot drive in virtual time"),
        (["--lockstep", "--bus", "nosuch"], "--bus: not with --lockstep"),
        (["--service", "s.toml"], "--service: with --lockstep only; in real time"),
        (["--service", "s.toml", "--train", "1", "--desk", "manual"], "--desk: not with --train"),
        (["--service", "s.toml", "--train", "1", "--line-peer"], "--line-peer: not with --train"),
        (["--lockstep", "--plant", "none"], "--plant: not with --lockstep"),
        (["--lockstep", "--tags", "/dev/ttyUSB0"], "--tags: not with --lockstep"),
        (["--lockstep", "--radio", "tcp/127.0.0.1:7447"], "--radio: not with --lockstep"),
        (["--driver", "late", "--desk-recording", "x.desk"], "not together with --driver"),
        (["--desk", "none", "--driver", "late"], "--driver: the plant has no desk"),
        (
            ["--desk", "external", "--desk-recording", "x"],
            "--desk-recording: the plant has no desk",
        ),
        (["--driver", "asleep"], "invalid choice"),
        (["--desk", "crew"], "invalid choice"),
        (["--lockstep", "--allow-faults", "--plant", "command:x"], "leave out --plant"),
        (["--allow-faults", "--plant", "none"], "--allow-faults: only with the train of the bench"),
        (["--lockstep", "--desk", "browser", "--plant", "command:x"], "--desk browser: with"),
        (["--lockstep", "--allow-faults", "--trains", "2"], "--allow-faults: not with --trains"),
        (["--desk", "browser", "--driver", "late"], "--driver: a viewer drives"),
        (["--line-peer"], "--line-peer: needs --train"),
        (["--train", "T1", "--line-peer", "--secure", "s"], "--line-peer: not with --secure"),
        (["--line-radio", "tcp/127.0.0.1:7448"], "--line-radio: needs --train"),
        (["--secure", "somewhere"], "--secure: needs --train"),
        (["--line-timers", "B"], "--line-timers: needs --train"),
        (["--arbiters", "3"], "--arbiters: needs --train"),
        (["--train", "T1", "--arbiters", "2"], "invalid choice"),
        (["--train", "T1", "--line-timers", "D"], "invalid choice"),
        (["--train", "T1", "--line-radio", "foo"], "--line-radio foo: not an endpoint"),
        (["--train", "T1", "--line-radio", "tcp/h:0"], "--line-radio tcp/h:0: not an endpoint"),
    ],
)
def test_impossible_options_are_refused(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        parse(["run", *words])

    assert ended.value.code == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "mode", "elsewhere"),
    [
        ([], CabMode.AUTO, False),
        (["--desk", "manual"], CabMode.MANUAL, False),
        (["--desk", "off"], CabMode.OFF, False),
        (["--desk", "none"], CabMode.AUTO, True),
    ],
)
def test_the_plant_gets_the_desk_options_of_a_run(
    words: list[str], mode: CabMode, elsewhere: bool
) -> None:
    scenario = scenario_of(parse(["run", "--lockstep", *words]))

    assert (scenario.desk_mode, scenario.desk_elsewhere) == (mode, elsewhere)


def test_the_plant_gets_the_driver() -> None:
    options = parse(["run", "--lockstep", "--desk", "manual", "--driver", "reckless"])

    assert scenario_of(options).driver == "reckless"


def test_a_train_of_a_line_uses_the_waysides_defaults() -> None:
    options = parse(["run", "--train", "T3"])

    told = (options.train, options.line_radio, options.line_timers, options.arbiters)
    assert told == (3, "tcp/127.0.0.1:7448", "A", 1)


def test_timers_and_arbiters_of_the_line_follow_the_options() -> None:
    options = parse(["run", "--train", "T3", "--line-timers", "B", "--arbiters", "3"])

    words = [*line_arguments(options), *controller_line_arguments(options)]
    told = vobc_parser().parse_args(words)
    assert (told.train, told.line_timers, told.arbiters) == (3, "B", 3)
    plant_parser().parse_args(["run", *line_arguments(options)])


def test_a_run_without_a_line_passes_no_line_options() -> None:
    options = parse(["run"])

    assert [*line_arguments(options), *controller_line_arguments(options)] == []


@pytest.mark.parametrize(
    ("words", "where"),
    [
        (["--line", "loop"], ""),
        (["--line", "my line.toml"], " --line 'my line.toml'"),
        (
            ["--line", "loop", "--line-radio", "tcp/h:7448", "--secure", "ca"],
            " --line-radio tcp/h:7448 --secure ca",
        ),
    ],
)
def test_the_hint_to_release_a_train_names_its_line(words: list[str], where: str) -> None:
    no_flags = (Inhibit(0), Withheld(0), 0)
    picture = BusPicture(250_000)
    picture.latest = {
        VobcStatus: VobcStatus(
            Supervision.EMERGENCY, AtoPhase.OFF, Missing(0), True, False, 900.0, 0
        ),
        VobcMode: VobcMode(OperatingMode.AUTHORISED, Cause.REMOTE, *no_flags, True, False),
    }
    said = hints_of(parse(["run", "--train", "T3", *words]))(picture)

    release = f"`vobc emergency-brake T3 --end{where}` releases the train"
    assert said == [f"waits for the centre: {release}"]


def test_trains_of_two_waysides_have_buses_of_their_own() -> None:
    def bus(*words: str) -> str:
        return own_bus_name(parse(["run", *words]))

    names = [
        bus("--train", "T1"),
        bus("--train", "T2"),
        bus("--train", "T1", "--line-radio", "tcp/127.0.0.1:7500"),
        bus("--train", "T1", "--line-radio", "tcp/127.0.0.2:7500"),
        bus("--train", "T64999", "--line-radio", "tcp/127.0.0.2:7500"),
    ]

    assert len({*names}) == len(names)
    assert all(BUS_NAME.fullmatch(name) for name in names)
    assert bus("--train", "T1", "--line-radio", LINE_ENDPOINT) == names[0] == "train1"


def test_the_controller_of_a_line_keeps_its_memory_in_the_run_folder_or_where_the_user_says(
    tmp_path: Path,
) -> None:
    for words, folder in (([], tmp_path), (["--memory", "kept"], Path("kept"))):
        options = parse(["run", "--train", "T3", *words])
        told = vobc_parser().parse_args(memory_arguments(options, tmp_path))

        assert (told.nvram, told.line_memory) == (str(folder / "nvram"), str(folder / "terms"))
    assert memory_arguments(parse(["run"]), tmp_path) == []


def test_memory_needs_a_train(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parse(["run", "--memory", "kept"])

    assert "--memory: needs --train" in capsys.readouterr().err
