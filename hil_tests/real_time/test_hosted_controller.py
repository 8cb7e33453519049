"""`vobc host` gives a controller of the lockstep interface the real wires."""

import select
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from can_dbc.brake import BrakeCommand
from can_dbc.codec import Decoder
from firmware_py.buses.embedded import open_embedded, start_hub
from firmware_py.storage.nvram import Nvram
from metro_hil.external_controller.realtime import main

BUS = "hosted0"
CONTROLLER = """
import json, sys
for line in sys.stdin:
    heard = json.loads(line)
    if heard["type"] == "hello":
        first, cycles = heard["told"]["grid_ns"], 0
        print(json.dumps({"type": "ready", "version": 1, "next_wakeup_ns": first}), flush=True)
        continue
    cycles += 1
    if cycles == 5:
        sys.exit(7)
    now_ns = heard["now_ns"]
    frames = [[257, "D057008766"], [258, "2FA800C944"]]
    print(json.dumps({"type": "yield", "now_ns": now_ns, "next_wakeup_ns": now_ns + 20000000,
                      "frames": frames}), flush=True)
"""
"""Sends one pair of brake commands in each of four cycles, then ends with 7."""


@pytest.fixture(autouse=True)
def hub() -> Iterator[None]:
    handle = start_hub(BUS, bound=True)
    yield
    handle.stop()


def hosted(folder: Path, *options: str) -> int:
    wires = ["--bus", f"embedded:{BUS}", "--tags", str(folder / "none"), "--from", "II"]
    wires += ["--radio", "tcp/127.0.0.1:1", "--priority", "0"]
    return main([*wires, *options, "--", sys.executable, "-c", CONTROLLER])


def test_its_frames_reach_the_bus_and_its_end_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tap = open_embedded(BUS, node="TAP")

    assert hosted(tmp_path, "--nvram", str(tmp_path / "memory")) == 1

    select.select([tap], [], [], 5.0)
    decoder = Decoder([BrakeCommand])
    heard = [decoder.decode(each.can_id, each.data, each.stamp_ns) for each in tap.receive(0)]
    tap.close()
    assert BrakeCommand(2.0, emergency_released=False, holding_released=False) in heard
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("vobc: controller died at t=")
    assert error.endswith("exit code 7; the train brakes without it")
    memory = Nvram(str(tmp_path / "memory"))
    assert memory.record.boot_count > 1
    assert memory.record.front_m is None


def test_a_command_or_a_bus_that_is_missing_is_named(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["--from", "II"]) == 2
    assert main(["--bus", "embedded:none0", "--", "./none"]) == 3

    no_command, no_bus = capsys.readouterr().err.splitlines()
    assert no_command == "vobc: host: no command; put -- and the controller's command at the end"
    assert "none0" in no_bus
