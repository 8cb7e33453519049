"""Two cases on the kernel's own CAN, run by their test in the guest; prints the results as JSON."""

import json
import sys
from contextlib import ExitStack
from pathlib import Path

import msgspec

from firmware_py import rendezvous
from firmware_py.clock.clock import WallClock
from metro_hil.model.case import BenchKind, Case, Setup
from metro_hil.model.run_folder import RunFolder
from metro_hil.model.subprocesses import Child
from metro_hil.realtime import RealtimeWires, run_realtime_case

RADIO = "tcp/127.0.0.1:17447"
TRAIN_START_S = 60.0
SETUP = Setup(start="II", end="III", duration_s=12.0, cycle_ms=100.0)

MONITORS: tuple[dict[str, object], ...] = (
    {"name": "said on the bus", "stl": "always(ceiling_mps <= 30.0)", "unit": "m/s"},
    {"name": "true of the train", "stl": "always(speed_mps <= 30.0)", "unit": "m/s"},
)


def main(folder: Path) -> None:
    """Print both results on standard output, by name."""
    results = {"split": _split(folder / "split"), "real_train": _real_train(folder / "real_train")}
    print(json.dumps({name: msgspec.to_builtins(result) for name, result in results.items()}))


def _split(out: Path) -> object:
    """Controller on vcan0 and train on vcan1, with a gateway between them that drops brake
    commands."""
    out.mkdir()
    drop = {"kind": "frame_drop", "frames": "BRAKE_CMD*", "start_s": 5.0, "duration_s": 2.0}
    wires = RealtimeWires(bus_a="socketcan:vcan0", bus_b="socketcan:vcan1")
    return run_realtime_case(
        _case(BenchKind.PROCESSES, faults=(drop,)), folder=RunFolder(out), wires=wires
    )


def _real_train(out: Path) -> object:
    """A case with an existing train whose tag reader is on a terminal.

    The bench starts only the controller and does not receive the truth.
    """
    out.mkdir()
    with ExitStack() as stack:
        words = ["run", "--bus", "socketcan:vcan1", "--radio", RADIO, "--from", "II", "--to", "III"]
        train = Child("train", "plant_emulator", words, out.parent / "train.log")
        stack.callback(train.end)
        tags = _terminal_of(rendezvous.tags_link("vcan1"))
        wires = RealtimeWires(bus_a="socketcan:vcan1", tags=tags, radio=RADIO)
        case = _case(BenchKind.HARDWARE, monitors=MONITORS)
        return run_realtime_case(case, folder=RunFolder(out), wires=wires)


def _terminal_of(link: Path) -> str:
    """The terminal behind the link, once the train has created it."""
    clock = WallClock()
    until_ns = clock.now_ns() + round(TRAIN_START_S * 1e9)
    while not link.is_symlink():
        assert clock.now_ns() < until_ns, "no train came up"
        clock.wait_until(clock.now_ns() + 50_000_000)
    return str(link.readlink())


def _case(
    bench: BenchKind,
    *,
    faults: tuple[dict[str, object], ...] = (),
    monitors: tuple[dict[str, object], ...] = (),
) -> Case:
    return Case(
        id="one",
        index=0,
        scenario="hop",
        seed=1,
        setup=SETUP,
        bench=bench,
        faults=faults,
        monitors=monitors,
        invariants="none",
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
