"""The desk on its wires: inside the plant, and as the process `plant desk` on the embedded bus."""

import os
import pty
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from can_dbc.binding import Frame, can_id
from can_dbc.cab import CabMode, Desk
from can_dbc.codec import Decoder, Encoder, Rejected
from can_dbc.diagnostics import HEARTBEATS
from can_dbc.nodes import Node
from can_dbc.vobc import VobcMotion
from firmware_py.buses.embedded import start_hub
from firmware_py.buses.inproc import InprocBus
from firmware_py.radio.inproc_radio import InprocRadio
from firmware_py.storage.growing_file import GrowingFile
from firmware_py.tag_reader.inproc_line import inproc_line
from plant_emulator.cli import main
from plant_emulator.cli.desk_command import DeskNode
from plant_emulator.desk.recording import load_recording
from plant_emulator.faults.plan import read_faults
from plant_emulator.process import PlantDevice
from plant_emulator.world import STEP_NS, TrainScenario, plan_scenario

BUS = "desktest0"
SPEC = f"embedded:{BUS}"
WAIT_S = 60.0
"""Timeout far above every duration here; only a hang reaches it, s."""


class DeskRig:
    """A plant on a virtual bus, and the frames that its desk sends."""

    def __init__(self, scenario: TrainScenario, *faults: dict[str, object]) -> None:
        self.bus = InprocBus("vcan0", 250_000)
        self.ear = self.bus.port("EAR", ())
        self.ids = {can_id(Desk), can_id(HEARTBEATS[Node.DESK])}
        self.port = self.bus.port("VOBC", self.ids)
        self.encoder, self.decoder = Encoder(), Decoder([Desk, HEARTBEATS[Node.DESK]])
        self.plant = PlantDevice(
            scenario,
            open_port=lambda node, ids: self.bus.port(node.name, ids),
            tags=inproc_line()[0],
            radio=InprocRadio().port("wayside", ()),
            truth=None,
            start_ns=0,
            faults=read_faults(faults, "test"),
        )
        self.now_ns = 0

    def run(self, duration_s: float, shown: VobcMotion | None = None) -> list[Frame]:
        """The frames that the desk sends meanwhile."""
        said: list[Frame] = []
        for step in range(round(duration_s * 1e9) // STEP_NS):
            if shown is not None and step % 10 == 0:
                for identifier, data in self.encoder.encode(shown):
                    self.ear.send(self.now_ns, identifier, data)
            self.plant.executive.run_due(self.now_ns)
            self.now_ns += STEP_NS
            self.bus.advance(self.now_ns)
            for frame in self.port.receive(self.now_ns):
                heard = self.decoder.decode(frame.can_id, frame.data, frame.stamp_ns)
                assert not isinstance(heard, Rejected)
                if heard is not None:
                    said.append(heard)
        return said

    def levers(self, duration_s: float, shown: VobcMotion | None = None) -> list[float]:
        said = self.run(duration_s, shown)
        return [frame.lever_percent for frame in said if isinstance(frame, Desk)]


def test_a_driver_in_the_plant_sees_the_controllers_frames_on_the_bus() -> None:
    bench = DeskRig(plan_scenario(driver="obedient"))
    assert set(bench.levers(1.0)) == {-100.0}, "the display is dark"
    assert bench.levers(1.0, VobcMotion(0.0, 15.0, 17.0))[-1] == 100.0
    assert bench.levers(1.0, VobcMotion(16.0, 15.0, 17.0))[-1] == -100.0
    assert bench.plant.wire.commands == 0
    assert bench.plant.wire.refused == 0


def test_desk_faults_override_the_driver() -> None:
    fault = {"kind": "desk_lever", "lever_percent": 30.0, "start_s": 1.0, "end_s": 2.0}
    bench = DeskRig(plan_scenario(driver="reckless"), fault)
    assert set(bench.levers(0.95)) == {100.0}
    assert bench.levers(1.0)[2:] == [30.0] * 8
    assert bench.levers(1.0)[2:] == [100.0] * 8


def test_a_recording_is_played_at_its_instants(tmp_path: Path) -> None:
    path = tmp_path / "a.desk"
    path.write_text("0 lever_percent=20\n0.6 lever_percent=-40 mode=off\n", encoding="utf-8")
    bench = DeskRig(plan_scenario(desk_recording=str(path), desk_mode="manual"))
    said = [frame for frame in bench.run(1.0) if isinstance(frame, Desk)]
    assert [frame.lever_percent for frame in said] == [20.0] * 6 + [-40.0] * 4
    assert (said[0].mode, said[-1].mode) == (CabMode.MANUAL, CabMode.OFF)


def test_a_plant_with_an_external_desk_sends_no_desk_frames() -> None:
    bench = DeskRig(plan_scenario(desk_elsewhere=True))
    assert bench.run(3.0) == []
    bench.plant.stop(bench.now_ns)
    assert bench.run(0.5) == []


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with tempfile.TemporaryDirectory() as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        handle = start_hub(BUS, bound=True)
        yield
        handle.stop()


def start(*arguments: str | Path) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-m", "plant_emulator", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.usefixtures("hub")
def test_a_playback_on_a_bus_is_recorded_unchanged(tmp_path: Path) -> None:
    played, recorded = tmp_path / "in.desk", tmp_path / "out.desk"
    played.write_text("0 lever_percent=20\n0.5 lever_percent=-40\n", encoding="utf-8")
    desk = start(
        *("desk", "--bus", SPEC, "--play", played, "--record", recorded, "--duration", "0.9")
    )
    said, errors = desk.communicate(timeout=WAIT_S)

    assert (desk.returncode, errors) == (0, "")
    assert said == f"plant: desk on {SPEC}; Ctrl-C leaves it\n"
    changes = load_recording(str(recorded)).changes
    levers = [dict(each.values)["lever_percent"] for each in changes]
    assert levers == [20.0, -40.0]
    assert changes[1].t_s >= 0.5


@pytest.mark.usefixtures("hub")
def test_two_desks_on_one_bus_are_refused_and_a_plant_can_leave_the_desk_to_another_process() -> (
    None
):
    plant = start("run", "--bus", SPEC, "--priority", "0", "--desk", "external")
    assert plant.stdout is not None
    first = None
    try:
        assert any("wayside:" in line for line in plant.stdout)
        first = start("desk", "--bus", SPEC, "--driver", "reckless")
        assert first.stdout is not None
        assert "desk on" in first.stdout.readline()
        second = start("desk", "--bus", SPEC, "--driver", "late")
        _, errors = second.communicate(timeout=WAIT_S)
    finally:
        for process in filter(None, (first, plant)):
            process.terminate()
            process.communicate(timeout=WAIT_S)
    assert second.returncode == 3
    assert errors == (
        f"plant: {SPEC}: another desk is already on the bus; run the plant with --desk external\n"
    )
    assert first is not None
    assert (first.returncode, plant.returncode) == (0, 0)


@pytest.mark.usefixtures("hub")
def test_a_person_drives_with_the_keys_of_a_terminal(tmp_path: Path) -> None:
    record = tmp_path / "hand.desk"
    outer, inner = pty.openpty()
    desk = subprocess.Popen(
        [sys.executable, "-m", "plant_emulator", "desk", "--bus", SPEC, "--record", record],
        stdin=inner,
        stdout=inner,
        stderr=subprocess.PIPE,
        env={**os.environ, "TERM": "xterm", "LINES": "24", "COLUMNS": "80"},
    )
    os.close(inner)
    screen = b""
    while b"leave the desk" not in screen:
        screen += os.read(outer, 4096)
    os.write(outer, b"\x1bOA\x1bOAq")
    while True:
        try:
            if not os.read(outer, 4096):
                break
        except OSError:
            break
    _, errors = desk.communicate(timeout=WAIT_S)
    os.close(outer)

    assert (desk.returncode, errors) == (0, b"")
    first, *_, last = load_recording(str(record)).changes
    assert dict(first.values)["lever_percent"] == 0.0
    assert last.values == (("lever_percent", 20.0),)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--play", "nowhere.desk"], 2, "nowhere.desk: no such file"),
        (["--driver", "late", "--bus", "embedded:nobody0"], 3, "nobody0"),
        (
            ["--bus", SPEC],
            3,
            "plant desk needs a terminal, or --play FILE, --driver NAME or --keys FILE",
        ),
    ],
)
def test_an_impossible_desk_is_refused_in_one_line(
    arguments: list[str], code: int, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["desk", *arguments]) == code
    said = capsys.readouterr().err
    assert words in said
    assert said.startswith("plant: ")
    assert said.count("\n") == 1


@pytest.mark.usefixtures("hub")
def test_a_recording_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "kept.desk"
    path.write_text("# mine\n", encoding="utf-8")
    assert main(["desk", "--bus", SPEC, "--driver", "late", "--record", str(path)]) == 2
    assert "the file exists and is not overwritten" in capsys.readouterr().err
    assert path.read_text(encoding="utf-8") == "# mine\n"


def test_keys_come_from_a_file_that_grows(tmp_path: Path) -> None:
    bus, path = InprocBus("vcan0", 250_000), tmp_path / "desk.keys"
    ear, decoder = bus.port("EAR", {can_id(Desk)}), Decoder([Desk])
    pressed = GrowingFile(path)
    desk = DeskNode(
        bus.port("DESK", ()),
        who=None,
        mode=CabMode.MANUAL,
        terminal=None,
        pressed=pressed.lines,
        record=None,
        start_ns=0,
    )
    seen = []
    for number, text in enumerate(("", "up\nu", "p\nnonsense\n\xff\nup\na", "\n")):
        with path.open("a", encoding="latin-1") as keys:
            keys.write(text)
        desk.cycle(number * 100_000_000)
        bus.advance((number + 1) * 100_000_000)
        for frame in ear.receive((number + 1) * 100_000_000):
            heard = decoder.decode(frame.can_id, frame.data, frame.stamp_ns)
            assert isinstance(heard, Desk)
            seen.append((heard.lever_percent, heard.mode))

    pressed.close()
    manual = CabMode.MANUAL
    assert seen == [(0.0, manual), (10.0, manual), (30.0, manual), (30.0, CabMode.AUTO)]
