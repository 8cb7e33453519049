"""The command `vcan` carries out its plan, shows it, and falls back to the embedded bus."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field

import pytest

from firmware_py.buses.embedded import ClientStatus, HubStatus
from firmware_py.buses.errors import BusError
from metro_tools import vcan
from metro_tools.vcan_plan import CanSupport, Kernel, KernelLink

ABLE = Kernel(CanSupport.READY, "the module vcan is loaded", True, True, True, True)
BARE = Kernel(CanSupport.ABSENT, "no CAN in its configuration", True, True, True, True)


@dataclass
class PaperWorld:
    """A simulated machine that records the commands."""

    given_kernel: Kernel
    kernel_links: dict[str, KernelLink] = field(default_factory=dict)
    hubs: dict[str, HubStatus] = field(default_factory=dict)
    commands_work: bool = True
    hubs_start: bool = True
    ran: list[tuple[str, ...]] = field(default_factory=list)

    def kernel(self) -> Kernel:
        return self.given_kernel

    def link(self, name: str) -> KernelLink | None:
        return self.kernel_links.get(name)

    def links(self) -> list[KernelLink]:
        return list(self.kernel_links.values())

    def run(self, words: Sequence[str]) -> bool:
        self.ran.append(tuple(words))
        return self.commands_work

    def hub(self, name: str) -> HubStatus | None:
        return self.hubs.get(name)

    def hub_names(self) -> list[str]:
        return sorted(self.hubs)

    def start_hub(self, name: str) -> None:
        if not self.hubs_start:
            raise BusError(f"embedded:{name}: the hub did not come up")
        self.hubs[name] = hub(name)

    def stop_hub(self, name: str) -> None:
        del self.hubs[name]


def hub(name: str, *, bound: bool = False) -> HubStatus:
    clients = (ClientStatus("VOBC", 5, 0, 0), ClientStatus("PLANT", 6, 0, 1))
    return HubStatus(name, 4711, bound, 1.0, 11, 1, 0, clients)


def run(world: PaperWorld, *argv: str) -> int:
    return vcan.obey(vcan.parse(argv), world)


def test_up_runs_each_command_after_showing_it(capsys: pytest.CaptureFixture[str]) -> None:
    world = PaperWorld(ABLE)

    status = run(world, "up", "vcan3")

    out = capsys.readouterr().out
    assert status == 0
    assert world.ran[0] == ("ip", "link", "add", "dev", "vcan3", "type", "vcan")
    shown = [line for line in out.splitlines() if line.startswith("+ ")]
    assert len(shown) == len(world.ran)
    assert "socketcan:vcan3" in out


def test_dry_run_shows_the_plan_and_runs_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    able, bare = PaperWorld(ABLE), PaperWorld(BARE)

    assert run(able, "up", "--dry-run") == 0
    assert run(bare, "up", "--dry-run") == 0

    assert (able.ran, bare.ran, bare.hubs) == ([], [], {})
    out = capsys.readouterr().out
    assert "+ ip link add dev vcan0 type vcan" in out
    assert "+ start the embedded bus vcan0" in out


def test_without_kernel_can_up_names_the_reason_and_starts_the_embedded_bus(
    capsys: pytest.CaptureFixture[str],
) -> None:
    world = PaperWorld(BARE)

    assert run(world, "up") == 0

    streams = capsys.readouterr()
    assert list(world.hubs) == ["vcan0"]
    assert "no CAN in its configuration" in streams.err
    assert "embedded:vcan0" in streams.out


def test_up_may_be_run_twice_with_either_bus(capsys: pytest.CaptureFixture[str]) -> None:
    embedded = PaperWorld(BARE, hubs={"vcan0": hub("vcan0")})
    kernel = PaperWorld(
        ABLE, kernel_links={"vcan0": KernelLink("vcan0", "vcan", is_up=True, is_ours=True)}
    )

    assert run(embedded, "up") == 0
    assert run(kernel, "up") == 0

    assert kernel.ran == []
    assert capsys.readouterr().out.count("already up") == 2


def test_after_a_failed_kernel_command_only_auto_falls_back(
    capsys: pytest.CaptureFixture[str],
) -> None:
    strict, auto = PaperWorld(ABLE, commands_work=False), PaperWorld(ABLE, commands_work=False)

    assert run(strict, "up", "--kind", "kernel") == 3
    assert run(auto, "up") == 0

    assert len(strict.ran) == len(auto.ran) == 1
    assert (list(strict.hubs), list(auto.hubs)) == ([], ["vcan0"])
    assert "failed" in capsys.readouterr().err


def test_a_machine_without_any_bus_is_an_environment_error(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(PaperWorld(BARE, hubs_start=False), "up") == 3

    assert "did not come up" in capsys.readouterr().err


@pytest.mark.parametrize("verb", ["up", "down", "status"])
def test_an_invalid_bus_name_is_a_usage_error(
    verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(PaperWorld(ABLE), verb, "sixteen_letters_") == 2

    assert "too long" in capsys.readouterr().err


@pytest.mark.parametrize("argv", [[], ["sideways"], ["up", "--kind", "wrong"], ["up", "a", "b"]])
def test_a_wrong_command_line_ends_with_2(
    argv: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ending:
        vcan.parse(argv)

    assert ending.value.code == 2
    assert "usage" in capsys.readouterr().err


def test_an_interface_of_another_kind_blocks_both_kinds_of_bus(
    capsys: pytest.CaptureFixture[str],
) -> None:
    links = {"eth0": KernelLink("eth0", "ether", is_up=True, is_ours=False)}

    for kind in ("auto", "kernel", "embedded"):
        world = PaperWorld(BARE, kernel_links=links)
        assert run(world, "up", "--kind", kind, "eth0") == 3
        assert world.hubs == {}
    assert capsys.readouterr().err.count("ether") == 3


def test_down_stops_the_hub_that_up_started_but_not_that_of_a_run(
    capsys: pytest.CaptureFixture[str],
) -> None:
    world = PaperWorld(BARE, hubs={"a": hub("a"), "b": hub("b", bound=True)})

    assert run(world, "down", "a") == 0
    assert run(world, "down", "a") == 0
    assert run(world, "down", "b") == 3

    assert list(world.hubs) == ["b"]
    assert "belongs to a run" in capsys.readouterr().err


def test_down_deletes_the_interface_that_up_created() -> None:
    world = PaperWorld(
        ABLE, kernel_links={"vcan0": KernelLink("vcan0", "vcan", is_up=True, is_ours=True)}
    )

    assert run(world, "down") == 0

    assert world.ran == [("ip", "link", "delete", "dev", "vcan0")]


def test_status_lists_every_bus_with_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    world = PaperWorld(
        ABLE,
        kernel_links={
            "can0": KernelLink("can0", "can", is_up=False, is_ours=False, frames=9, dropped=2)
        },
        hubs={"vcan0": hub("vcan0")},
    )

    assert run(world, "status", "--json") == 0

    assert json.loads(capsys.readouterr().out) == [
        {
            "name": "can0",
            "kind": "kernel can",
            "up": False,
            "bus": "socketcan:can0",
            "frames": 9,
            "dropped": 2,
            "clients": None,
            "made_by_vcan": False,
        },
        {
            "name": "vcan0",
            "kind": "embedded",
            "up": True,
            "bus": "embedded:vcan0",
            "frames": 11,
            "dropped": 1,
            "clients": ["VOBC", "PLANT"],
            "made_by_vcan": True,
        },
    ]


def test_the_exit_code_of_status_shows_whether_one_bus_is_up(
    capsys: pytest.CaptureFixture[str],
) -> None:
    world = PaperWorld(
        ABLE,
        kernel_links={"vcan1": KernelLink("vcan1", "vcan", is_up=False, is_ours=False)},
        hubs={"vcan0": hub("vcan0")},
    )

    codes = {name: run(world, "status", name) for name in ("vcan0", "vcan1", "vcan2")}

    assert codes == {"vcan0": 0, "vcan1": 3, "vcan2": 3}
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == [
        "vcan0",
        "embedded",
        "up",
        "11",
        "1",
        "VOBC,PLANT",
        "embedded:vcan0",
    ]
