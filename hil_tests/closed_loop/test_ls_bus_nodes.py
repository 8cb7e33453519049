"""FMUs with CAN by FMI-LS-BUS as nodes: small ones of ours, and the public demo nodes."""

import subprocess
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Final

import fmpy
import pytest

from firmware_py.clock.executive import Executive, Task
from hil_tests.nodes import KINDS, make_nodes
from metro_hil.cli.hil import main
from metro_hil.fmi_export.export import binaries_folder
from metro_hil.foreign_plant.node_bus import BusRun, run_nodes
from metro_hil.foreign_plant.node_host import serve
from metro_hil.foreign_plant.node_messages import NodeGo, NodeHello, encode
from metro_hil.foreign_plant.nodes_file import ErrorKeys, NodeKeys, NodesFile, nodes_of
from metro_hil.foreign_plant.plant import PlantDiedError
from metro_hil.model.case import Case, PlantSpec, Setup, Verdict
from metro_hil.model.case_setup import parts_of
from metro_hil.run.case import run_alone
from metro_hil.run.lockstep import Lockstep, Taps

MS: Final = 1_000_000
DEMO: Final = "can-node-triggered-output"


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory, c_compiler: str) -> dict[str, Path]:
    return make_nodes(tmp_path_factory.mktemp("nodes"), c_compiler)


def node(fmu: Path, name: str, kind: str, **more: float) -> NodeKeys:
    number = float(KINDS.index(kind))
    return NodeKeys(str(fmu), name=name, parameters={"kind": number, **more})


def run(
    *nodes: NodeKeys, ms: int = 20, log: Path | None = None, errors: tuple[ErrorKeys, ...] = ()
) -> BusRun:
    checked = nodes_of(NodesFile(nodes, errors), Path(), "")
    return run_nodes(checked, ms * MS, log, lease_s=0.3)


def test_nodes_of_both_clocks_send_and_answer(fmus: dict[str, Path], tmp_path: Path) -> None:
    log = tmp_path / "bus.log"
    done = run(
        node(fmus["triggered"], "sender", "SENDER", identifier=0x123, bit_rate=500_000),
        node(fmus["counting"], "echo", "ECHO"),
        ms=25,
        log=log,
    )

    assert done.bit_rate == 500_000
    assert [line.split()[0][-7:-1] + line.split()[2] for line in log.read_text().splitlines()] == [
        "010110123#01",
        "010224124#01",
        "020108123#02",
        "020222124#02",
    ]
    sender, echo = (done.nodes[name][0] for name in ("sender", "echo"))
    assert (sender.confirmed, sender.received) == (echo.received, echo.confirmed) == (2, 2)


def test_a_node_that_counts_its_errors_agrees_with_the_bus(fmus: dict[str, Path]) -> None:
    done = run(
        node(fmus["counting"], "one", "CONFINED", period_us=5000),
        node(fmus["triggered"], "two", "CONFINED", period_us=1_000_000),
        ms=50,
        errors=(ErrorKeys("one", 0.025, 0.035),),
    )

    states = [each.state.value for each in done.events if each.node == "one"]
    assert states == ["error passive", "bus off", "error active"]
    counts, tec, _ = done.nodes["one"]
    assert (counts.off, counts.malformed, tec) == (1, 0, 0)
    assert [each.node for each in done.events].count("two") == 0


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("TICKER", "hangs: 1000 ticks of its clock at 0.01 s"),
        ("TALKER", "floods the bus: 85000 bytes at one instant"),
        ("QUITTER", "ends the simulation at 0.01 s"),
        ("LAGGARD", "doStep at 0 s: the FMU returns early, which is not allowed"),
    ],
)
def test_the_host_ends_a_bad_node_with_one_line(
    fmus: dict[str, Path], capsys: pytest.CaptureFixture[str], kind: str, words: str
) -> None:
    hello = NodeHello("test", str(fmus["counting"]), "CAN", {"kind": KINDS.index(kind)}, MS)
    lines = encode(hello) + encode(NodeGo(10 * MS, ""))

    assert serve(BytesIO(lines), BytesIO()) == 1

    assert capsys.readouterr().err == f"{words}\n"


def test_a_node_that_hangs_ends_the_run(fmus: dict[str, Path]) -> None:
    words = "node bad hung at t=0.010000 s: no answer within 0.3 s"
    with pytest.raises(PlantDiedError, match=f"^{words}$"):
        run(node(fmus["counting"], "bad", "HANGER"))


def test_the_command_runs_a_file_of_nodes(
    fmus: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = fmus["counting"].parent / "bus.toml"
    file.write_text(
        '[[node]]\nfmu = "counting.fmu"\nname = "one"\n'
        '[[node]]\nfmu = "triggered.fmu"\nreceives = [0x101]\n'
        "parameters = {kind = 6, period_us = 1000}\n"
    )
    log = tmp_path / "bus.log"

    assert main(["bus", str(file), "--for", "0.0255", "--log", str(log)]) == 0

    said = capsys.readouterr().out.splitlines()
    assert said == [
        "2 frames at 250000 bit/s, bus load 1.9%",
        "node            sent  confirmed  received  TEC  REC  what else",
        "one                2          2         0    0    0",
        "triggered          0          0         0    0    0  malformed 25",
        f"written: {log}",
    ]
    assert log.read_text().count("100#") == 2


def test_a_log_that_cannot_be_written_gives_one_line(
    fmus: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bus", str(fmus["counting"]), "--log", str(tmp_path)]) == 3

    assert "cannot be written" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "node: missing; the file needs at least one [[node]]"),
        ("[[node]]\nfmu", "not TOML"),
        ('[[node]]\nfmu = "x.fmu"\nstep_ms = 0', "node[0]: step_ms 0.0 is not in 0.01..1000"),
        ('[[node]]\nfmu = "x.fmu"\nreceives = [2048]', "receives 0x800 is not within 0..0x7ff"),
        ('[[node]]\nfmu = "a.fmu"\n[[node]]\nfmu = "a.fmu"', "two nodes are called 'a'"),
        (
            '[[node]]\nfmu = "a.fmu"\n[[error]]\nnode = "b"\nfrom_s = 0\nuntil_s = 1',
            "error[0].node: 'b': valid nodes: a",
        ),
        (
            '[[node]]\nfmu = "a.fmu"\n[[error]]\nnode = "a"\nfrom_s = 2\nuntil_s = 1',
            "until_s 1 is not after from_s 2",
        ),
    ],
)
def test_a_mistake_in_a_file_of_nodes_gives_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    file = tmp_path / "bus.toml"
    file.write_text(text)

    assert main(["bus", str(file)]) == 2

    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


@pytest.fixture(scope="module")
def demo(
    tmp_path_factory: pytest.TempPathFactory, c_compiler: str, ls_bus_sources: tuple[Path, Path]
) -> Path:
    """The public demo node, built from its sources; docs/reference/ls_bus.md says where from."""
    source, made = ls_bus_sources[0] / DEMO, tmp_path_factory.mktemp("demo")
    name, (place, suffix) = "DemoCanNodeTriggeredOutput", binaries_folder()
    flags = ["-std=gnu99", "-w", "-fPIC", "-shared", "-D_strdup=strdup"]
    flags += ["-DFMI3_OVERRIDE_FUNCTION_PREFIX", f"-I{ls_bus_sources[1]}"]
    flags += [f"-I{Path(fmpy.__file__).parent / 'c-code'}"]
    sources = sorted(map(str, (source / "src").glob("*.c")))
    subprocess.run([c_compiler, *flags, *sources, "-o", str(made / name)], check=True)
    with zipfile.ZipFile(made / "demo.fmu", "w") as fmu:
        description = source / "description"
        fmu.write(description / "modelDescription.xml", "modelDescription.xml")
        fmu.write(description / "terminalsAndIcons.xml", "terminalsAndIcons/terminalsAndIcons.xml")
        fmu.write(made / name, f"{place}/{name}{suffix}")
    return made / "demo.fmu"


def test_the_public_demo_nodes_run_and_recover_from_bus_off(demo: Path, tmp_path: Path) -> None:
    nodes = (NodeKeys(str(demo), name="one"), NodeKeys(str(demo), name="two"))
    keys = NodesFile(nodes, (ErrorKeys("one", 0.5, 0.7),))
    log = tmp_path / "bus.log"

    done = run_nodes(nodes_of(keys, Path(), ""), 1000 * MS, log)

    assert done.bit_rate == 100_000
    frames = [line.split() for line in log.read_text().splitlines()]
    assert {text for _, _, text in frames} == {"001#01020304"}
    assert [stamp for stamp, *_ in frames] == [
        "(0000000000.300830)",
        "(0000000000.301690)",
        "(0000000000.612190)",
        "(0000000000.900830)",
        "(0000000000.901690)",
    ]
    off, active = (each.at_ns for each in done.events[1:])
    assert active - off == 1408 * 10_000


def nodes_file(fmus: dict[str, Path], name: str, kind: str) -> PlantSpec:
    file = fmus["counting"].parent / f"{name}.toml"
    file.write_text(
        f'[[node]]\nfmu = "counting.fmu"\nname = "{name}"\nreceives = [0x101]\n'
        f"parameters = {{kind = {KINDS.index(kind)}, identifier = 0x7A0}}\n"
    )
    return PlantSpec(kind="nodes", nodes=str(file), lease_s=30.0)


def case(plant: PlantSpec) -> Case:
    setup = Setup(start="II", end="III", duration_s=1.0)
    return Case(id="x", index=0, scenario="x", seed=4, setup=setup, plant=plant)


def test_a_node_on_the_train_bus_gives_the_frames_of_a_native_one(fmus: dict[str, Path]) -> None:
    spec = nodes_file(fmus, "one", "SENDER")
    parts = parts_of(case(spec))

    def frames(plant: PlantSpec) -> list[tuple[int, int, bytes]]:
        found: list[tuple[int, int, bytes]] = []
        taps = Taps(frame=lambda *frame: found.append(frame))
        bench = Lockstep(parts.config, parts.scenario, parts.journey, taps=taps, plant=plant)
        if plant == PlantSpec():
            port = bench.bus.port("one", ())

            def send(now_ns: int) -> None:
                port.send(now_ns, 0x7A0, bytes([now_ns // (10 * MS)]))

            bench._executives.append(Executive([Task("one", 10.0, send, 10.0)], 0))
        bench.run(0.6)
        bench.close()
        # The native node does not act at the end, 600 ms.
        return [frame for frame in found if frame[0] < 600 * MS]

    native = frames(PlantSpec())

    assert [can_id for _, can_id, _ in native].count(0x7A0) == 59
    assert frames(spec) == native


def test_a_bad_node_on_the_train_bus_blocks_the_case(fmus: dict[str, Path]) -> None:
    result = run_alone(case(nodes_file(fmus, "bad", "CRASHER")))

    assert result.verdict is Verdict.BLOCKED
    assert result.reason == "node bad died at t=0.010000 s: signal SIGABRT"


def test_a_node_may_not_have_the_name_of_a_unit(fmus: dict[str, Path]) -> None:
    result = run_alone(case(nodes_file(fmus, "BCU", "SENDER")))

    assert result.verdict is Verdict.BLOCKED
    assert "node name 'BCU' is one of the bench; choose another" in result.reason
