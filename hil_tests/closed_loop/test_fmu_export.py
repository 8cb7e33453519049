"""Train and controller as FMUs with CAN by FMI-LS-BUS: valid, and frame for frame like ours."""

import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import fmpy
import pytest
from fmpy.validation import validate_fmu
from lxml import etree

from can_dbc.brake import BrakeCommand
from can_dbc.codec import Encoder
from firmware_py.buses.confinement import RECOVERY_BITS
from firmware_py.clock.clock import LockstepClock
from firmware_py.clock.executive import run
from firmware_py.handed_ports import HandedPorts
from metro_hil.cli.hil import main
from metro_hil.external_controller.choice import memory_of
from metro_hil.fmi_export.descriptions import ABOUT, manifest, terminals
from metro_hil.fmi_export.export import write_fmu
from metro_hil.foreign_plant import ls_bus
from metro_hil.foreign_plant.fmu import Fmu, FmuError
from metro_hil.foreign_plant.ls_bus import BusErrorCode
from metro_hil.foreign_plant.plant_terminal import PlantTerminal
from metro_hil.foreign_plant.terminal_node import TerminalNode, members_of, notify
from metro_hil.model.case import Case, PlantSpec, Setup
from metro_hil.model.case_setup import parts_of
from metro_hil.run.lockstep import Lockstep, Taps
from vobc.process import Commission

SCHEMA: Final = Path(fmpy.__file__).parent / "schema" / "fmi3"
SETUP: Final = Setup(start="II", end="III")
MS: Final = 1_000_000
CONFIGURED: Final = bytes.fromhex("400000000d0000000190d00300400000000a0000000401")
STATUS: Final = {number: b"\x41\0\0\0\x09\0\0\0" + bytes([number]) for number in (1, 2, 3)}
ECHO: Final = """\
import json, sys
how = sys.argv[1]
for line in sys.stdin:
    message = json.loads(line)
    if message["type"] == "hello":
        if how == "refuse":
            print(json.dumps({"type": "refuse", "reason": "not today"}), flush=True)
            continue
        print(json.dumps({"type": "ready", "version": 1, "next_wakeup_ns": 20000000}), flush=True)
        continue
    if how == "die" and message["now_ns"] > 20000000:
        sys.exit(3)
    frames = [[7, ""], [0x123, "00ff"]] + [[each[1] + 1, each[2]] for each in message["frames"]]
    answer = {
        "type": "yield",
        "now_ns": message["now_ns"],
        "next_wakeup_ns": message["now_ns"] + 20000000,
        "frames": frames,
        "serial": [json.dumps(message["frames"]).encode().hex()],
        "radio": [["a/b", "01"]],
    }
    print(json.dumps(answer), flush=True)
"""
"""Yields two frames at each grant, and each received one with the next identifier."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, c_compiler: str) -> Path:
    assert c_compiler
    made = tmp_path_factory.mktemp("export")
    for what in ("train", "controller"):
        words = ["--from", "II", "--to", "III", "--seed", "4", "--out", str(made / f"{what}.fmu")]
        assert main(["export", what, *words]) == 0
    return made


Start = Callable[[Path], PlantTerminal]


@pytest.fixture
def start(c_compiler: str) -> Iterator[Start]:
    """Starts FMUs at the instant 0, and ends them after the test."""
    assert c_compiler
    running: list[Fmu] = []

    def node_of(path: Path) -> PlantTerminal:
        fmu = Fmu(path, events=True)
        running.append(fmu)
        fmu.start(0.0)
        also = ("Serial.Tx_Data", "Radio.Tx_Data")
        node = PlantTerminal(fmu, members_of(fmu, "CAN", "test"), also)
        node.begin(0)
        return node

    yield node_of
    for fmu in running:
        fmu.close()


def ridden(plant: PlantSpec) -> tuple[list[tuple[int, int, bytes]], list[Any]]:
    """All frames of 2 s before the end of the run, and the truth after each step."""
    parts = parts_of(Case(id="x", index=0, scenario="x", seed=4, setup=SETUP))
    frames: list[tuple[int, int, bytes]] = []
    truth: list[Any] = []
    taps = Taps(
        frame=lambda *frame: frames.append(frame),
        truth=lambda each, now_ns: truth.append(each.pack()),
    )
    bench = Lockstep(parts.config, parts.scenario, parts.journey, taps=taps, plant=plant)
    bench.run(2.0)
    count = len(frames)
    bench.close()
    return frames[:count], truth


def test_the_exported_train_gives_every_frame_and_the_truth_of_the_shipped_one(
    folder: Path,
) -> None:
    own, other = (
        ridden(plant)
        for plant in (
            PlantSpec(),
            PlantSpec(kind="fmu", mapping=str(folder / "train.toml"), lease_s=30.0),
        )
    )

    assert len(own[0]) > 600
    assert other == own


def test_the_exported_controller_sends_the_frames_of_the_shipped_one(
    folder: Path, start: Start
) -> None:
    parts = parts_of(Case(id="x", index=0, scenario="x", seed=4, setup=SETUP))
    ports = HandedPorts()
    journey = parts.journey
    with zipfile.ZipFile(folder / "controller.fmu") as fmu:
        assert b"wheel_diameter_m" in fmu.read("resources/hello.json")
    commission = Commission(
        parts.config, journey.line, journey.mission, memory_of(journey, parts.config), 0
    )
    device = commission.device(can=ports.can, tags=ports.tags, radio=ports.radio)
    run([device.executive], LockstepClock(), lambda now_ns: now_ns > 500_000_000)
    node = start(folder / "controller.fmu")

    frames = list(node.frames)
    for number in range(1, 51):
        node.advance(number * 10_000_000, [])
        frames += node.frames

    assert frames == list(ports.take().frames)
    assert len(frames) > 50


@pytest.mark.parametrize("what", ["train", "controller"])
def test_public_tools_find_nothing_wrong(folder: Path, what: str) -> None:
    assert validate_fmu(str(folder / f"{what}.fmu")) == []


def test_terminals_and_manifest_follow_their_schemas() -> None:
    schema = etree.XMLSchema(etree.parse(SCHEMA / "fmi3TerminalsAndIcons.xsd"))
    schema.assertValid(etree.fromstring(terminals().encode()))

    root = etree.fromstring(manifest().encode())
    space = "{http://fmi-standard.org/fmi-ls-manifest}"
    assert root.tag == "fmiLayeredStandardManifest"
    assert dict(root.attrib) == {
        f"{space}fmi-ls-name": "org.fmi-standard.fmi-ls-bus",
        f"{space}fmi-ls-version": "1.0.0",
        f"{space}fmi-ls-description": ABOUT,
    }


def test_equal_exports_are_equal_files(folder: Path, tmp_path: Path) -> None:
    words = ["--from", "II", "--to", "III", "--seed", "4", "--out", str(tmp_path / "train.fmu")]

    assert main(["export", "train", *words]) == 0

    assert (tmp_path / "train.fmu").read_bytes() == (folder / "train.fmu").read_bytes()


def test_a_station_that_is_not_there_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "train", "--to", "XX", "--out", str(tmp_path / "x.fmu")]) == 2

    assert "--to XX: line florence has no station XX" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def echo(tmp_path: Path, how: str) -> Path:
    program = tmp_path / "echo.py"
    program.write_text(ECHO)
    path = tmp_path / f"{how}.fmu"
    write_fmu(path, "echo", (sys.executable, str(program), how), {})
    return path


def test_a_program_behind_the_fmu_sends_and_receives_at_its_wakeups(
    tmp_path: Path, start: Start
) -> None:
    node = start(echo(tmp_path, "echo"))

    node.advance(10_000_000, [])
    assert (node.frames, node.all_texts) == ([], [])
    node.advance(40_000_000, [(15_000_000, 0x10, b"\x01"), (30_000_000, 0x11, b"")])

    first = [(7, b""), (0x123, b"\x00\xff")]
    assert node.frames == [*first, (0x11, b"\x01"), *first, (0x12, b"")]
    serial, radio, *_ = node.all_texts
    assert bytes.fromhex(serial.decode().strip('"')) == b'[[15000000, 16, "01"]]'
    assert radio == b'["a/b", "01"]'


def test_an_operation_that_is_none_gives_a_format_error_at_once(
    tmp_path: Path, start: Start
) -> None:
    node = start(echo(tmp_path, "echo"))
    wrong = [
        b"\x10\x00\x00\x00",
        b"\x10\x00\x00\x00\x00\x00\x00\x00",
        ls_bus.transmit(0x10, b"\x01")[:-1],
        ls_bus.transmit(0x800, b""),
        b"\x99\x00\x00\x00\x08\x00\x00\x00",
        b"\x11\x00\x00\x00\x11\x00\x00\x00" + bytes(9),
        ls_bus.confirm(1)[:8],
    ]
    for operation in wrong:
        node.go(node.now_ns, operation)

        assert node.sent == ls_bus.format_error(operation)
    assert node.due_ns == 20 * MS


def test_a_node_ignores_what_is_for_the_bus_or_wakes_nodes(tmp_path: Path, start: Start) -> None:
    node = start(echo(tmp_path, "echo"))

    node.go(0, ls_bus.wakeup() + STATUS[3] + CONFIGURED + ls_bus.arbitration_lost(7))

    assert node.sent == b""


def test_the_node_configures_the_bus_at_the_start(tmp_path: Path, start: Start) -> None:
    assert start(echo(tmp_path, "echo")).sent == CONFIGURED


def test_the_node_counts_errors_reports_its_state_and_recovers(tmp_path: Path) -> None:
    fmu = Fmu(echo(tmp_path, "echo"), events=True)
    try:
        members = members_of(fmu, "CAN", "test")
        assert notify(fmu, members)
        fmu.start(0.0)
        node = TerminalNode(fmu, members)
        node.begin(0)
        own, other = (ls_bus.bus_error(7, BusErrorCode.BIT, sender=own) for own in (True, False))
        unacknowledged = ls_bus.bus_error(7, BusErrorCode.ACKNOWLEDGE, sender=True)

        told = {}
        for count, operation in enumerate(
            (
                *(*[other] * 128, ls_bus.transmit(8, b"")),
                *(*[own] * 16, *[unacknowledged] * 9, ls_bus.confirm(7), *[own] * 17),
            ),
            1,
        ):
            node.go(MS, operation)
            if node.sent:
                told[count] = node.sent
        # A passive node does not count a missing acknowledgement.
        assert told == {
            128: STATUS[2],
            129: STATUS[1],
            145: STATUS[2],
            155: STATUS[1],
            156: STATUS[2],
            172: STATUS[3],
        }
        off_ns = MS + RECOVERY_BITS * 4000
        assert node.due_ns == off_ns
        node.go(MS, ls_bus.transmit(8, b""))
        node.go(off_ns)
        assert node.sent == STATUS[1]
        node.go(20 * MS)
        frames = [ls_bus.frame_of(each) for each in ls_bus.operations(node.sent)]
        # The frame of identifier 8 came while the node was bus off; one came before.
        assert frames == [(7, b""), (0x123, b"\x00\xff"), (9, b"")]
    finally:
        fmu.close()


def test_a_program_that_ends_or_refuses_is_an_error_of_the_fmu(
    tmp_path: Path, start: Start
) -> None:
    node = start(echo(tmp_path, "die"))
    node.advance(20_000_000, [])

    with pytest.raises(FmuError, match="getBinary"):
        node.advance(40_000_000, [])
    with pytest.raises(FmuError, match="enterInitializationMode"):
        start(echo(tmp_path, "refuse"))


def test_a_protected_frame_passes_an_fmu_unchanged(tmp_path: Path, start: Start) -> None:
    """The shim must not touch counter, CRC or twin."""
    node = start(echo(tmp_path, "echo"))
    sent = Encoder().encode(BrakeCommand(0.5, emergency_released=True, holding_released=True))

    node.advance(20_000_000, [(15_000_000, can_id, data) for can_id, data in sent])

    assert node.frames[2:] == [(can_id + 1, data) for can_id, data in sent]
