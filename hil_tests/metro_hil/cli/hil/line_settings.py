"""Checks the options of `hil run line` and writes them to run.toml."""

import argparse
import shlex
from collections.abc import Sequence
from typing import Any, Final

from firmware_py.radio.zenoh_radio import pick_endpoint
from firmware_py.trackdb import LineMap, load_line
from firmware_py.trackdb.areas import load_areas
from metro_hil.engine.errors import UsageError
from metro_hil.line.exercise.plan import ONE_WAY, Fault, PlannedRun, Strike, faults_of, ways_of
from metro_hil.line.exercise.real_time import Settings
from metro_hil.line.exercise.virtual import NOT_HERE
from metro_hil.line.network.options import OwnNetworks, networks_of
from metro_hil.line.network.packet_process import OWN_ENDPOINT
from metro_hil.line.network.topology import Topology
from zenoh_config.sessions import check_secured, is_loopback
from zenoh_config.timers import TIMER_SETS

DEFAULT_LINE: Final = "loop"
TRAINS: Final = 4
"""Number of trains that the user did not name."""
LOCKSTEP: Final = "lockstep"
DURATION_MAX_S: Final = 1e9
"""Maximum duration of a run, about thirty years, s."""
INTERNAL: Final = ("run", "words", "apart", "verb")
"""Entries of the parsed options that are not the user's."""


def settings_of(options: argparse.Namespace) -> Settings:
    """Raises UsageError and SettingsError for options that do not fit together."""
    options.line = options.line or DEFAULT_LINE
    options.trains = TRAINS if options.trains is None else options.trains
    areas, line = load_areas(options.line), load_line(options.line)
    ways, faults = _ways(options, line), faults_of(options)
    refuse_faults(options, faults)
    networks = networks_of(options, needed=any(each.strike in ONE_WAY for each in faults))
    _refuse_places(options, networks)
    return Settings(
        line=line,
        areas=areas,
        line_name=options.line,
        ways=ways,
        endpoint=options.line_radio or (pick_endpoint() if networks is None else OWN_ENDPOINT),
        timers=options.line_timers,
        arbiters=options.arbiters,
        faults=faults,
        down_s=options.down_s,
        duration_s=options.duration_s,
        priority=options.priority,
        secure=options.secure,
        networks=networks,
        topology=_topology(options, faults, networks),
    )


def _ways(options: argparse.Namespace, line: LineMap) -> list[PlannedRun]:
    try:
        if options.line_radio is not None:
            check_secured(
                options.line_radio, secured=options.secure is not None, insecure=options.insecure
            )
        return ways_of(line, options.trains)
    except ValueError as error:
        raise UsageError(str(error)) from error


def refuse_faults(options: argparse.Namespace, faults: Sequence[Fault]) -> None:
    """Raises UsageError for faults that the run cannot have."""
    if not 0.0 < options.duration_s <= DURATION_MAX_S:
        raise UsageError(f"--for {options.duration_s:g}: not a duration")
    for each in faults:
        if options.trains is not None and each.train > options.trains:
            raise UsageError(f"--{each.strike.value} T{each.train}: there is no such train")
        if options.bench == LOCKSTEP and each.strike in NOT_HERE:
            raise UsageError(f"--{each.strike.value}: not in lockstep")
        if each.at_s >= options.duration_s:
            at = f"T{each.train}@{each.at_s:g}" if each.train else f"{each.at_s:g}"
            ends = f"the run ends before, by --for {options.duration_s:g}"
            raise UsageError(f"--{each.strike.value} {at}: {ends}")


def _refuse_places(options: argparse.Namespace, networks: OwnNetworks | None) -> None:
    """Refuse options that need a network that the run lacks, or another one."""
    lockstep, apart = options.bench == LOCKSTEP, networks is not None
    radio, secure = options.line_radio, options.secure
    for refused, words in (
        (lockstep and apart, "--bench lockstep has no network"),
        (lockstep and radio is not None, f"--line-radio {radio}: --bench lockstep has no network"),
        (lockstep and secure is not None, f"--secure {secure}: --bench lockstep has no network"),
        (apart and radio is not None, "--line-radio does not go with networks of their own"),
        (apart and secure is not None, "--secure does not go with networks of their own"),
        (
            apart and options.watch,
            "--watch does not go with networks of their own; `vobc watch` shows the run from "
            "another terminal",
        ),
        (options.commands and not options.watch, "--commands is for the page; add --watch"),
        (
            lockstep and options.commands,
            "--commands: --bench lockstep has no radio that takes them",
        ),
    ):
        if refused:
            raise UsageError(words)


def _topology(
    options: argparse.Namespace, faults: Sequence[Fault], networks: OwnNetworks | None
) -> Topology:
    """Raises UsageError for options that need a star."""
    topology = Topology(options.topology)
    cut = any(each.strike is Strike.CUT_MASTER for each in faults)
    for given, words in (
        (options.bench == LOCKSTEP, "--bench lockstep has no sessions"),
        (networks is not None, "networks of their own lead to the wayside only"),
        (options.secure is not None, "not with --secure: peers bypass the wayside's rules"),
        (cut, "--cut-master-at cuts the way to the wayside only"),
    ):
        if given and topology is not Topology.STAR:
            raise UsageError(f"--topology {topology.value}: {words}")
    return topology


def radio_words(settings: Settings) -> str:
    """Text with the address of the line's radio and a command to watch it."""
    if settings.networks is not None:
        return "line radio: in a network of its own, which nothing outside of the run reaches"
    words = ["vobc", "line", "--watch", "--line-radio", settings.endpoint]
    if settings.line_name != DEFAULT_LINE:
        words += ["--line", settings.line_name]
    if settings.secure is not None:
        words += ["--secure", str(settings.secure)]
    elif not is_loopback(settings.endpoint):
        words += ["--insecure"]
    return f"line radio: {settings.endpoint}; watch it with `{shlex.join(words)}`"


def config_of(options: argparse.Namespace, settings: Settings) -> dict[str, object]:
    """The tables of run.toml."""
    asked = {name: value for name, value in vars(options).items() if name not in INTERNAL}
    trains = enumerate(settings.ways, start=1)
    networks = settings.networks
    return {
        "bench": options.bench,
        "seed": options.seed,
        "options": {name: value for name, value in asked.items() if not callable(value)},
        "line": {
            "name": settings.areas.name,
            "line_radio": None if options.bench == LOCKSTEP else settings.endpoint,
            "arbiters": settings.arbiters,
            "topology": settings.topology.value,
            "timers": TIMER_SETS[settings.timers],
        },
        "trains": [{"train": number, "from": way.start, "to": way.end} for number, way in trains],
        "faults": [_fault(each) for each in settings.faults],
        "networks": {} if networks is None else networks._asdict(),
    }


def _fault(fault: Fault) -> dict[str, Any]:
    of_train = {"train": fault.train} if fault.strike is Strike.RESTART_TRAIN else {}
    return {"fault": fault.strike.value.removesuffix("-at"), "at_s": fault.at_s, **of_train}
