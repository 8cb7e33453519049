"""The commands of a case's processes, and which processes the bench starts."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from can_dbc.nodes import Node
from metro_hil.model.case import BenchKind, Case, ControllerSpec, Setup
from metro_hil.realtime.commands import (
    CommandPlaceholders,
    ControllerStart,
    controller_start,
    fill_in,
    gateway_words,
    plant_words,
)
from metro_hil.realtime.wires import Blocked, Parts, Presence, RealtimeWires, choose_parts

PLACES = CommandPlaceholders(
    bus="embedded:h1-0a",
    tags="/run/a b/tags",
    radio="tcp/127.0.0.1:7000",
    line="florence",
    params="florence4",
    start="II",
    end="III",
    out="/runs/one",
)


def start_of(controller: ControllerSpec, places: CommandPlaceholders = PLACES) -> ControllerStart:
    return controller_start(
        controller,
        places,
        cycle_ms=50.0,
        priority=80,
        nvram=Path("/runs/one/nvram"),
        environment={"HOME": "/root"},
    )


def value_of(words: tuple[str, ...] | list[str], option: str) -> str:
    return words[words.index(option) + 1]


def test_the_shipped_controller_gets_all_its_wires_and_the_position_of_the_train() -> None:
    words = start_of(ControllerSpec()).words(0)

    assert words[:4] == (sys.executable, "-m", "vobc", "--bus")
    assert value_of(words, "--bus") == "embedded:h1-0a"
    assert value_of(words, "--tags") == "/run/a b/tags"
    assert value_of(words, "--from") == "II"
    assert value_of(words, "--out") == "/runs/one"


def test_the_controller_gets_a_timetable_that_passes_stations() -> None:
    places = replace(PLACES, stops="III")

    assert value_of(start_of(ControllerSpec(), places).words(0), "--stops") == "III"
    assert "--stops" not in start_of(ControllerSpec()).words(0)
    words = start_of(
        ControllerSpec(kind="command", command="ctl {bus} --at {stops}"), places
    ).words(0)
    assert words == ("ctl", "embedded:h1-0a", "--at", "III")


def test_a_program_without_an_option_to_pass_stations_is_not_started() -> None:
    with pytest.raises(Blocked, match="here III"):
        start_of(ControllerSpec(kind="command", command="ctl {bus}"), replace(PLACES, stops="III"))


def test_after_a_kill_only_the_memory_gives_the_position() -> None:
    start = start_of(ControllerSpec())

    again = start.words(1)

    assert "--from" not in again
    assert value_of(again, "--nvram") == value_of(start.words(0), "--nvram")
    assert value_of(again, "--out") == "/runs/one/again1"


def test_another_version_is_the_same_program_in_another_folder(tmp_path: Path) -> None:
    (tmp_path / "vobc").mkdir()

    start = start_of(ControllerSpec(kind="checkout", path=str(tmp_path)))

    assert start.environment["PYTHONPATH"].split(":")[0] == str(tmp_path)
    assert start.environment["HOME"] == "/root"
    assert start.words(0)[1:3] == ("-m", "vobc")


def test_an_invalid_checkout_blocks_the_case(tmp_path: Path) -> None:
    with pytest.raises(Blocked, match="is not a checkout"):
        start_of(ControllerSpec(kind="checkout", path=str(tmp_path)))


def test_a_command_is_split_like_in_a_shell_and_filled_in_without_one() -> None:
    words = fill_in("./mine --tags {tags} --to='{end} now' $HOME", PLACES)

    assert words == ("./mine", "--tags", "/run/a b/tags", "--to=III now", "$HOME")


def test_a_command_without_a_bus_is_hosted_and_after_a_kill_its_place_is_unknown() -> None:
    places = replace(PLACES, stops="III")
    start = start_of(ControllerSpec(kind="command", command="./mine 'a b' {line}"), places)

    first, again = start.words(0), start.words(1)

    assert first[1:3] == ("-m", "metro_hil.external_controller.realtime")
    assert first[first.index("--") :] == ("--", "./mine", "a b", "florence")
    assert value_of(first, "--bus") == "embedded:h1-0a"
    assert value_of(first, "--from") == "II"
    assert value_of(first, "--stops") == "III"
    assert "--from" not in again
    assert value_of(again, "--nvram") == "/runs/one/nvram"


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("", "empty"),
        ("./mine {tag}", "{tag}"),
        ("./mine {grant}", "{grant}"),
        ("./mine 'x", "quotation"),
        ("./mine {", "'{'"),
    ],
)
def test_a_command_that_cannot_be_filled_in_blocks_the_case(command: str, words: str) -> None:
    with pytest.raises(Blocked) as caught:
        fill_in(command, PLACES)

    assert words in str(caught.value)


def test_the_plant_gets_faults_feed_and_fixed_values() -> None:
    case = Case(
        id="c1",
        index=0,
        scenario="s",
        seed=7,
        setup=Setup(load_ratio=0.5, odometer_error=-0.01, desk_mode="manual"),
    )

    words = plant_words(
        case,
        bus="embedded:b",
        wires=RealtimeWires(),
        radio="tcp/127.0.0.1:7000",
        line="florence",
        consist="florence4",
        faults=Path("/runs/one/faults.toml"),
        feed=Path("/run/h/truth"),
        out=Path("/runs/one"),
        stations=("II", "III"),
        parent=4711,
    )

    assert value_of(words, "--faults") == "/runs/one/faults.toml"
    assert value_of(words, "--truth-feed") == "/run/h/truth"
    assert value_of(words, "--seed") == "7"
    assert value_of(words, "--load-ratio") == "0.5"
    assert value_of(words, "--odometer-error") == "-0.01"
    assert value_of(words, "--desk") == "manual"
    assert value_of(words, "--parent") == "4711"


def test_the_gateway_connects_the_controller_to_a_and_the_train_to_b() -> None:
    words = gateway_words(
        segments=("socketcan:can0", "socketcan:can1"),
        faults=Path("f"),
        seed=3,
        control=Path("c"),
        out=Path("o"),
        priority=75,
        parent=1,
    )

    assert value_of(words, "--a") == "socketcan:can0"
    assert value_of(words, "--b") == "socketcan:can1"


TRAIN = {Node.BCU, Node.ODO}


@pytest.mark.parametrize(
    ("heard", "virtual", "parts"),
    [
        (set(), True, Parts(plant=True, controller=True)),
        ({Node.VOBC}, False, Parts(plant=True, controller=False)),
        (TRAIN, False, Parts(plant=False, controller=True)),
        (TRAIN | {Node.VOBC}, False, Parts(plant=False, controller=False)),
    ],
)
def test_the_bench_starts_the_missing_processes(
    heard: set[Node], virtual: bool, parts: Parts
) -> None:
    chosen = choose_parts(
        RealtimeWires(), bench=BenchKind.HARDWARE, virtual=virtual, heard=heard, where="can0"
    )

    assert chosen == parts


@pytest.mark.parametrize(
    ("wires", "heard", "words"),
    [
        (RealtimeWires(plant=Presence.OURS), TRAIN, "train is there already"),
        (RealtimeWires(controller=Presence.OURS), {Node.VOBC}, "controller is there already"),
        (RealtimeWires(), set(), "neither a train nor a controller"),
    ],
)
def test_duplicate_or_missing_processes_block_the_case(
    wires: RealtimeWires, heard: set[Node], words: str
) -> None:
    with pytest.raises(Blocked, match=words):
        choose_parts(wires, bench=BenchKind.HARDWARE, virtual=False, heard=heard, where="can0")
