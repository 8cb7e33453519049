"""Bring a virtual CAN bus up or down, or show the existing ones.

The bus is SocketCAN if the kernel has it, otherwise the embedded bus, which needs no module and no
privileges.
"""

import argparse
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import Final, Protocol

from firmware_py.arguments import words_of
from firmware_py.assertions import require_assertions
from firmware_py.buses.embedded import HubStatus, hub_status, start_hub, stop_hub
from firmware_py.buses.errors import BusError
from firmware_py.command_line import CommandParser
from firmware_py.rendezvous import bench_dir
from metro_tools import vcan_plan, vcan_survey
from metro_tools.bus_table import BusRow, hub_row, link_row, table
from metro_tools.vcan_plan import (
    Commands,
    Kernel,
    KernelLink,
    NameTaken,
    NotAvailable,
    Nothing,
    Step,
)

EXIT_OK: Final = 0
EXIT_USAGE: Final = 2
EXIT_ENVIRONMENT: Final = 3
COMMAND_TIMEOUT_S: Final = 30
DEFAULT_NAME: Final = "vcan0"

GUEST_HINT: Final = "real SocketCAN without a kernel module or root rights: vcan-guest COMMAND"


class HostWorld(Protocol):
    """Everything outside the program that the command uses; tests replace it."""

    def kernel(self) -> Kernel: ...

    def link(self, name: str) -> KernelLink | None: ...

    def links(self) -> list[KernelLink]: ...

    def run(self, words: Sequence[str]) -> bool:
        """Run a command and return whether it succeeded; it prints its own errors."""
        ...

    def hub(self, name: str) -> HubStatus | None: ...

    def hub_names(self) -> list[str]: ...

    def start_hub(self, name: str) -> None: ...

    def stop_hub(self, name: str) -> None: ...


def main(argv: Sequence[str] | None = None) -> int:
    """The console script `vcan`."""
    require_assertions("vcan")
    options = parser().parse_args(words_of("vcan", argv))
    return obey(options, RealMachine())


def obey(options: argparse.Namespace, world: HostWorld) -> int:
    """Execute the options in a world and return the exit code."""
    if options.name is not None and (fault := vcan_plan.name_fault(options.name)):
        return _complain(fault, EXIT_USAGE)
    try:
        if options.verb == "up":
            return _up(options.name or DEFAULT_NAME, options.kind, world, dry_run=options.dry_run)
        if options.verb == "down":
            return _down(options.name or DEFAULT_NAME, options.kind, world, dry_run=options.dry_run)
        return _status(options.name, world, as_json=options.json)
    except BusError as error:
        return _complain(str(error), EXIT_ENVIRONMENT)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Parse a command line; a wrong one ends the program with exit code 2."""
    return parser().parse_args(argv)


def parser() -> argparse.ArgumentParser:
    """Return the parser of `vcan`."""
    top = CommandParser(prog="vcan", is_command=True, description=__doc__)
    verbs = top.add_subparsers(dest="verb", required=True, metavar="up|down|status")
    for verb, words in (("up", "bring a bus up"), ("down", "remove a bus that `vcan up` made")):
        one = verbs.add_parser(verb, help=words, description=words)
        one.add_argument("name", nargs="?", metavar="NAME", help=f"default: {DEFAULT_NAME}")
        one.add_argument(
            "--kind",
            choices=("auto", "kernel", "embedded"),
            default="auto",
            help="SocketCAN only, the embedded bus only, or the first that works (default)",
        )
        one.add_argument(
            "--dry-run", action="store_true", help="show the commands without running them"
        )
    status = verbs.add_parser("status", help="show a bus, or all", description="show a bus, or all")
    status.add_argument("name", nargs="?", metavar="NAME", help="default: all")
    status.add_argument("--json", action="store_true", help="a list of objects on standard output")
    return top


def _up(name: str, kind: str, world: HostWorld, *, dry_run: bool) -> int:
    if kind != "kernel" and world.hub(name) is not None and world.link(name) is None:
        print(f"{name}: embedded bus, already up; use --bus embedded:{name}")
        return EXIT_OK
    if kind == "embedded":
        return _start_embedded(name, world, dry_run=dry_run)
    step = vcan_plan.plan_up(name, world.kernel(), world.link(name))
    if isinstance(step, Commands):
        step = _run_all(step, world, dry_run=dry_run)
    if not isinstance(step, NotAvailable) or kind == "kernel":
        return _conclude(step, f"{name}: kernel vcan is up; use --bus socketcan:{name}", dry_run)
    _print_lines(
        [
            *_missing_lines(step),
            f"so {name} becomes an embedded bus, which candump and cansend cannot use",
            GUEST_HINT,
        ]
    )
    return _start_embedded(name, world, dry_run=dry_run)


def _start_embedded(name: str, world: HostWorld, *, dry_run: bool) -> int:
    if (link := world.link(name)) is not None:
        return _complain(
            f"{name} is an interface of the kernel ({link.kind}); an embedded bus of the same name "
            "would be ambiguous; choose another name",
            EXIT_ENVIRONMENT,
        )
    print(f"+ start the embedded bus {name}")
    if not dry_run:
        world.start_hub(name)
        print(f"{name}: embedded bus is up; use --bus embedded:{name}")
    return EXIT_OK


def _down(name: str, kind: str, world: HostWorld, *, dry_run: bool) -> int:
    hub = world.hub(name) if kind != "kernel" else None
    if hub is not None:
        if hub.bound:
            return _complain(
                f"the embedded bus {name} belongs to a run and ends with it", EXIT_ENVIRONMENT
            )
        print(f"+ stop the embedded bus {name} (process {hub.pid})")
        if not dry_run:
            world.stop_hub(name)
            print(f"{name}: embedded bus is down")
        return EXIT_OK
    link = world.link(name) if kind != "embedded" else None
    if link is None:
        print(f"{name}: not up, nothing to do")
        return EXIT_OK
    step = vcan_plan.plan_down(name, world.kernel(), link)
    if isinstance(step, Commands):
        step = _run_all(step, world, dry_run=dry_run)
    return _conclude(step, f"{name}: kernel vcan is removed", dry_run)


def _run_all(plan: Commands, world: HostWorld, *, dry_run: bool) -> Step:
    """Print each command and run it; a failed one is returned as not available."""
    for words in plan.words:
        print(f"+ {shlex.join(words)}", flush=True)
        if not dry_run and not world.run(words):
            return NotAvailable(f"`{shlex.join(words)}` failed", ())
    return plan


def _conclude(step: Step, success: str, dry_run: bool) -> int:
    """Print the result and return the exit code."""
    match step:
        case Commands():
            if not dry_run:
                print(success)
            return EXIT_OK
        case Nothing(text):
            print(text)
            return EXIT_OK
        case NotAvailable():
            _print_lines(_missing_lines(step))
            return EXIT_ENVIRONMENT
        case NameTaken(text):
            return _complain(text, EXIT_ENVIRONMENT)


def _missing_lines(step: NotAvailable) -> list[str]:
    return [step.reason, *(f"to change that, type: {line}" for line in step.remedy)]


def _status(name: str | None, world: HostWorld, *, as_json: bool) -> int:
    rows = survey(name, world)
    if as_json:
        print(json.dumps([asdict(row) for row in rows], indent=2))
    elif rows:
        print(table(rows))
    else:
        print(f"{name} is not up" if name else "no bus is up", "(`vcan up` makes one)")
    if name is None:
        return EXIT_OK
    return EXIT_OK if any(row.up for row in rows) else EXIT_ENVIRONMENT


def survey(name: str | None, world: HostWorld) -> list[BusRow]:
    """Return the buses of that name, or all."""
    if name is None:
        links, hub_names = world.links(), world.hub_names()
    else:
        link = world.link(name)
        links, hub_names = [link] if link is not None else [], [name]
    hubs = [hub for hub in (world.hub(hub_name) for hub_name in hub_names) if hub is not None]
    return [link_row(link) for link in links] + [hub_row(hub) for hub in hubs]


def _print_lines(lines: Sequence[str]) -> None:
    for line in lines:
        print(f"vcan: {line}", file=sys.stderr, flush=True)


def _complain(text: str, code: int) -> int:
    _print_lines([text])
    return code


class RealMachine:
    """The real machine."""

    def __init__(self) -> None:
        self._places = vcan_survey.SystemPaths(release=os.uname().release)

    def kernel(self) -> Kernel:
        return vcan_survey.survey_kernel(self._places)

    def link(self, name: str) -> KernelLink | None:
        return vcan_survey.find_link(name, self._places)

    def links(self) -> list[KernelLink]:
        return vcan_survey.can_links(self._places)

    def run(self, words: Sequence[str]) -> bool:
        try:
            done = subprocess.run(  # noqa: S603 # the planned commands, without a shell
                words, stdin=subprocess.DEVNULL, timeout=COMMAND_TIMEOUT_S, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            _print_lines([str(error)])
            return False
        return done.returncode == 0

    def hub(self, name: str) -> HubStatus | None:
        return hub_status(name)

    def hub_names(self) -> list[str]:
        # Every bus has a folder beside the default bus's folder.
        benches = bench_dir(DEFAULT_NAME).parent
        return sorted(folder.name for folder in benches.iterdir() if folder.is_dir())

    def start_hub(self, name: str) -> None:
        start_hub(name, bound=False)

    def stop_hub(self, name: str) -> None:
        stop_hub(name)
