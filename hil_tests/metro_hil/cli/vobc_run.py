"""`vobc run`: parses, runs in real time or in lockstep, reports."""

import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from typing import NamedTuple

from rich.console import Console

from can_dbc.vobc import EventKind
from canlog.run_names import mark_latest
from firmware_py.buses import BusError
from firmware_py.clock.clock import WallClock
from firmware_py.output import working
from firmware_py.radio.credentials import load_credentials
from firmware_py.settings import SettingsError
from firmware_py.storage.recorder import loss_text
from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb import LineMap
from metro_hil.cli.realtime_run import RealtimeRun
from metro_hil.foreign_plant.plant import PlantDiedError
from metro_hil.metrics.comfort import comfort_of, inertia_of
from metro_hil.metrics.hops import hop_table, means_of, measure_hops
from metro_hil.metrics.results import RunResults, sha256_of
from metro_hil.metrics.run import (
    SupervisionEvent,
    measure_cycles,
    measure_ride,
    supervision_events,
)
from metro_hil.metrics.stops import measure_stops
from metro_hil.model.end_condition import INTERRUPTED, Ending
from metro_hil.model.log_columns import Columns, RunLogError, read_columns
from metro_hil.model.mission import Journey, check_reference, plan_journey
from metro_hil.model.run_folder import (
    RunFolder,
    RunFolderError,
    discard_unused,
    make_run_folder,
    write_config,
)
from metro_hil.model.run_options import (
    EXIT_ENVIRONMENT,
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_OK,
    EXIT_USAGE,
    RunOptions,
    parse,
)
from metro_hil.model.service import PlannedTrip, several
from metro_hil.model.subprocesses import ChildError
from metro_hil.model.terminal import console_for
from metro_hil.report.explain.event_log import RunEventsError, read_story
from metro_hil.report.table import print_results
from metro_hil.run.lockstep import Lockstep, config_of, run_lockstep, scenario_of
from metro_hil.run.turnback import (
    Departure,
    go_on,
    options_of,
    timed_journey,
    timed_scenario,
    trips_of,
)
from metro_hil.watch.companion import WatchPage
from plant_emulator.world import TrainScenario
from vobc.plausible import check_plausible
from zenoh_config.secured import train_name


class RunLogs(NamedTuple):
    """Logs of a run that is over; None for one that it does not have."""

    truth: Columns | None
    cycles: Columns | None


def main(argv: Sequence[str]) -> int:
    """Drive one run. `argv` begins with the word `run`."""
    return drive(parse(argv))


def drive(options: RunOptions) -> int:
    """Drive one run."""
    console = console_for(json=options.json)
    try:
        with working():
            code = _run(options, console)
    except (SettingsError, RunFolderError) as error:
        return _complain(error, EXIT_USAGE)
    except (BusError, ChildError, PlantDiedError, RunLogError) as error:
        return _complain(error, EXIT_ENVIRONMENT)
    if code == EXIT_INTERRUPTED:
        _complain("interrupted; these are the results until then", code)
    return code


def _complain(error: Exception | str, code: int) -> int:
    print(f"vobc: {error}", file=sys.stderr)
    return code


def _run(options: RunOptions, console: Console) -> int:
    if options.is_networked:
        from metro_hil.line.turning import networked_command

        return networked_command.run(options, console)
    fleet = options.masters or options.trains is not None or options.supply is not None
    if options.service is not None and (fleet or several(options.service)):
        from metro_hil.line.turning import command as turning_run

        return turning_run.run(options, console)
    if options.trains is not None:
        # The network of several trains may need a compiler, so it is imported only here.
        from metro_hil.line.virtual import command as line_run

        return line_run.run(options, console)
    if options.and_back is not None or options.service is not None:
        legs: list[RunResults] = []
        try:
            return _drive_trips(options, legs, console)
        finally:
            if options.json and legs:
                print(f'{{"legs": [{", ".join(each.to_json() for each in legs)}]}}')
    return _drive(options, plan_journey(options), scenario_of(options), console)


def _drive_trips(options: RunOptions, legs: list[RunResults], console: Console) -> int:
    """Drive the trips of a service, or out and back. A trip that fails ends them all."""
    trips = trips_of(options)
    chosen = options_of(options, trips)
    plans = [
        (timed_journey(trip, plan_journey(each)), timed_scenario(trip, scenario_of(each)))
        for trip, each in zip(trips, chosen, strict=True)
    ]
    for each, (journey, _) in zip(chosen, plans, strict=True):
        check_plausible(config_of(each), journey.line)
    departures: list[Departure] = []
    for number, (journey, scenario) in enumerate(plans):
        if departures:
            journey, scenario = departures[-1].journey(journey), departures[-1].scenario(scenario)
        ended = partial(_leave, departures, trips[number : number + 2])
        code = _drive(chosen[number], journey, scenario, console, legs=legs, ended=ended)
        if code != EXIT_OK:
            break
    errors_m = [abs(each.error_m) for leg in legs for each in leg.stops if each.error_m is not None]
    worst = f", worst stop error {100.0 * max(errors_m):.1f} cm" if errors_m else ""
    if options.hops:
        console.print(hop_table(means_of([hop for leg in legs for hop in leg.hops])))
    done = len(legs) - (code != EXIT_OK)
    console.print(f"{done} of {len(plans)} trips arrived{worst}", highlight=False)
    return code


def _leave(departures: list[Departure], trips: Sequence[PlannedTrip], bench: Lockstep) -> None:
    """Put the train on the path of the next trip, if there is one."""
    if len(trips) > 1:
        cab_b = bool(departures) and departures[-1].cab_b
        departures.append(go_on(bench, *trips, cab_b=cab_b))


def _drive(
    options: RunOptions,
    journey: Journey,
    scenario: TrainScenario,
    console: Console,
    *,
    legs: list[RunResults] | None = None,
    ended: Callable[[Lockstep], None] | None = None,
) -> int:
    """Drive one way, report it, and return the exit code.

    Args:
        legs: receives the results of a run in several parts; without it, --json prints them.
        ended: receives the bench at the end of a run in virtual time.
    """
    config = config_of(options)
    check_plausible(config, journey.line)
    if options.lockstep:
        check_reference(config, scenario.train)
    clock = WallClock()
    _check_line(options, journey.line, clock.epoch_ns())
    words = f"{journey.line.name}_{journey.start.name}-{journey.end.name}"
    folder = make_run_folder(options.out, clock.epoch_ns(), words)
    tables = {"options": options, "line": journey.line, "train": scenario.train, "vobc": config}
    write_config(folder, tables, clock.epoch_ns())
    mark_latest(folder.path)
    with ExitStack() as stack:
        page = _watched(stack, options, folder, console)
        if options.lockstep:
            ending = run_lockstep(options, journey, folder, scenario=scenario, ended=ended)
        else:
            try:
                ending = RealtimeRun(
                    options,
                    journey,
                    folder,
                    console,
                    check_train=lambda: check_reference(config, scenario.train),
                ).run()
            except (BusError, SettingsError):
                stack.close()
                discard_unused(folder)
                raise
        logs = read_logs(folder, ending)
        results = make_results(folder, journey, ending, logs, inertia_of(scenario.train))
        if legs is not None:
            legs.append(results)
        printed = options.json and legs is None
        code = _finish(options, journey, results, folder, ending, logs, console, printed=printed)
        if page is not None and ending.exit_reason != INTERRUPTED:
            page.stay(partial(console.print, highlight=False, soft_wrap=True))
    return code


def _watched(
    stack: ExitStack, options: RunOptions, folder: RunFolder, console: Console
) -> WatchPage | None:
    """Start the page of the run if the user wants it; it ends with `stack`."""
    if not options.watch:
        return None
    page = stack.enter_context(WatchPage(folder.path, *options.by_hand))
    console.print(page.line, highlight=False, soft_wrap=True)
    return page


def _finish(
    options: RunOptions,
    journey: Journey,
    results: RunResults,
    folder: RunFolder,
    ending: Ending,
    logs: RunLogs,
    console: Console,
    *,
    printed: bool,
) -> int:
    """Report the run, and return the exit code. `printed`: also as JSON on standard output."""
    try:
        report(folder, journey, results, logs, console, plot=_wants_plot(options))
        if options.hops and options.service is None and options.and_back is None:
            console.print(hop_table(means_of(results.hops)))
        if options.by_hand:
            console.print("`hil from-run` makes a scenario of what a person did", highlight=False)
    finally:
        if printed:
            print(results.to_json())
    if ending.lost_log_lines:
        lost = loss_text(ending.lost_log_lines)
        return _complain(f"{folder.path}: {lost}", EXIT_ENVIRONMENT)
    return _exit_code(ending)


def _check_line(options: RunOptions, line: LineMap, epoch_ns: int) -> None:
    """Check what a train that commands itself needs to join others. Raises SettingsError."""
    if options.train is None:
        return
    # Imported here, because it brings train-to-train control along.
    from vobc.cli.line import reachable_areas

    reachable_areas(options.line, line)
    if options.secure is None:
        return
    try:
        load_credentials(options.secure, train_name(options.train), epoch_ns)
    except SettingsError as error:
        raise SettingsError(f"--secure {options.secure}: {error}") from error


def _exit_code(ending: Ending) -> int:
    if ending.exit_reason == INTERRUPTED:
        return EXIT_INTERRUPTED
    return EXIT_FAILED if ending.failed else EXIT_OK


def read_logs(folder: RunFolder, ending: Ending) -> RunLogs:
    return RunLogs(
        truth=read_columns(folder.truth_log) if ending.truth_known else None,
        cycles=read_columns(folder.cycle_log) if folder.cycle_log.exists() else None,
    )


def make_results(
    folder: RunFolder, journey: Journey, ending: Ending, logs: RunLogs, inertia_kg: float
) -> RunResults:
    """Measure a run from its logs; measures that a short run did not reach are left out.

    Args:
        inertia_kg: mass of the emulated train with rotating parts; used only if that train ran.
    """
    truth, cycles = logs
    motion = truth or cycles
    stops = measure_stops(motion, journey.stops) if motion else ()
    return RunResults(
        exit_reason=ending.exit_reason,
        stops=stops,
        hops=measure_hops(truth, journey.start.name, stops) if truth else (),
        ride=measure_ride(motion) if motion else None,
        comfort=comfort_of(truth, cycles, inertia_kg=inertia_kg if truth else None),
        cycles=measure_cycles(cycles) if cycles else None,
        events=_events(folder, cycles),
        frames=ending.frames,
        bus_load_ratio=ending.bus_load_ratio,
        frame_log_sha256=sha256_of(folder.bus_log),
        real_time_factor=ending.real_time_factor,
        rejected_frames=ending.rejected_frames,
        truth_known=ending.truth_known,
        dropped_frames=ending.dropped_frames,
        lost_log_lines=ending.lost_log_lines,
        steal_s=ending.steal_s,
        realtime=ending.realtime,
        nodes=ending.nodes,
    )


def _events(folder: RunFolder, cycles: Columns | None) -> list[SupervisionEvent]:
    """Changes of protection, and reports of a late or weak brake, in order of time."""
    found = supervision_events(cycles) if cycles else []
    try:
        story = read_story(folder.path)
    except RunEventsError:
        return found
    found += [
        SupervisionEvent(event.t_s, event.kind.replace("_", " ").lower(), event.words)
        for event in story.events
        if event.kind in (EventKind.BRAKE_LATE.name, EventKind.BRAKE_WEAK.name)
    ]
    return sorted(found, key=lambda event: event.at_s)


def _wants_plot(options: RunOptions) -> bool:
    return not options.json if options.plot is None else options.plot


def report(
    folder: RunFolder,
    journey: Journey,
    results: RunResults,
    logs: RunLogs,
    console: Console,
    *,
    plot: bool,
) -> None:
    """Print the table, draw the plot if it is wanted, write the results file."""
    print_results(console, results)
    write_whole(folder.results, results.to_json() + "\n")
    if plot and logs.cycles and results.cycles and results.cycles.cycles > 1:
        from metro_hil.report.plot import draw_run

        title = f"{journey.line.name}: {journey.start.name} to {journey.end.name}"
        drawn = draw_run(folder.plot, title, journey.line, logs.cycles, logs.truth, results.stops)
        words = str(folder.plot) if drawn else "none, the train's place was never known"
        console.print(f"plot: {words}", highlight=False, soft_wrap=True)
    console.print(f"run folder: {folder.path}", highlight=False, soft_wrap=True)
