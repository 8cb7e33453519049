"""The verbs of `plant`: a train without a controller on a bus, a serial line and a radio."""

import argparse
import json
import sys
import traceback
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from can_dbc.binding import can_id
from can_dbc.cab import CabMode
from can_dbc.nodes import Node
from firmware_py import rendezvous
from firmware_py.arguments import of_file
from firmware_py.buses import BusError, open_can, parse_spec
from firmware_py.clock.clock import Clock, WallClock
from firmware_py.clock.executive import Executive, Task, run
from firmware_py.clock.realtime import collect_garbage, die_with_parent, enter_realtime
from firmware_py.interrupts import Interrupts
from firmware_py.ports import CanPort, RadioPort
from firmware_py.radio.silent_radio import SilentRadio
from firmware_py.radio.zenoh_radio import RadioError
from firmware_py.settings import SettingsError, shipped_names
from firmware_py.storage.recorder import LineLog, loss_text
from firmware_py.storage.whole_file import write_whole
from firmware_py.tag_reader.serial_line import SerialError
from plant_emulator.cli.bus_choice import chosen_bus
from plant_emulator.cli.by_hand import TrainByHand, open_by_hand
from plant_emulator.cli.desk_command import attend
from plant_emulator.cli.feed_sender import FeedSender
from plant_emulator.cli.line_wayside import feed_of, serve_line
from plant_emulator.cli.names import DESK
from plant_emulator.cli.openers import open_tags, open_wayside, refuse_second_plant
from plant_emulator.cli.options import AUTO, ELSEWHERE
from plant_emulator.cli.words import TrainNotices, say, summarise
from plant_emulator.desk.display import KINDS as DISPLAYED
from plant_emulator.faults.fault_file import load_faults
from plant_emulator.faults.fitting import check_fitting, check_provided, targets_of
from plant_emulator.faults.kinds import BENCH_PLACES, FaultPlace
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.foreign import ForeignParts, ForeignPartsError
from plant_emulator.process import TRUTH_COLUMNS, PlantDevice
from plant_emulator.train_config import PACKAGE, load_train
from plant_emulator.wire import COMMAND_IDS
from plant_emulator.world import TrainScenario, plan_scenario

EXIT_OK: Final = 0
EXIT_FAILED: Final = 1
EXIT_USAGE: Final = 2
EXIT_ENVIRONMENT: Final = 3

NS_PER_S: Final = 1_000_000_000
GARBAGE_MS: Final = 10_000.0

StartForeign = Callable[[TrainScenario, str, Clock, ExitStack], ForeignParts]
"""Starts the program that emulates parts of the train on a bus; the stack ends it."""


def serve(options: argparse.Namespace, start_foreign: StartForeign | None = None) -> int:
    """Run the verb. User errors give one line, never a traceback."""
    try:
        if options.verb == "consists":
            return _list_consists()
        if options.verb == "desk":
            return attend(options)
        if options.verb == "wayside":
            return serve_line(options)
        if options.trains is not None:
            return _serve_trains(options)
        if options.supply is not None:
            raise SettingsError("--supply: only with --trains; a single train has its own source")
        if options.traffic is not None:
            raise SettingsError("--traffic: only with --trains")
        _check_by_hand(options)
        elsewhere = options.desk in ELSEWHERE
        scenario = plan_scenario(
            line=options.line or "florence",
            consist=options.consist or "florence4",
            seed=options.seed,
            start=options.start,
            end=options.end,
            load_ratio=options.load_ratio,
            odometer_error_ratio=options.odometer_error,
            desk_mode=CabMode.AUTO if elsewhere else CabMode[options.desk.upper()],
            driver=options.driver,
            desk_recording=options.desk_recording,
            desk_elsewhere=elsewhere,
        )
        faults = () if options.faults is None else load_faults(options.faults)
        check_fitting(faults, targets_of(scenario), str(options.faults))
        return _serve(options, scenario, faults, start_foreign)
    except SettingsError as error:
        _complain(error)
        return EXIT_USAGE
    except (BusError, RadioError, SerialError, ForeignPartsError) as error:
        _complain(error)
        return EXIT_ENVIRONMENT
    except OSError as error:
        _complain(of_file(error))
        return EXIT_ENVIRONMENT
    except Exception:
        traceback.print_exc()
        _complain(
            "the plant failed; to the controller this looks like a train that stopped sending"
        )
        return EXIT_FAILED


def _serve_trains(options: argparse.Namespace) -> int:
    # Import the network only for several trains, because it may load a compiler.
    from plant_emulator.cli.line_command import serve_trains

    options.line = options.line or ("changping" if options.traffic is None else None)
    if options.desk != "auto":
        raise SettingsError("--desk: is for one train; not with --trains")
    return serve_trains(options)


def _list_consists() -> int:
    for name in shipped_names(PACKAGE):
        train = load_train(name)
        print(f"{name:24} {len(train.cars)} cars, {train.length_m:.2f} m: {train.description}")
    return EXIT_OK


def _serve(
    options: argparse.Namespace,
    scenario: TrainScenario,
    faults: Sequence[FaultPlan],
    start_foreign: StartForeign | None,
) -> int:
    if options.parent is not None:
        die_with_parent(options.parent)
    ending = Interrupts()
    with ending.caught(), ExitStack() as stack:
        clock = WallClock()
        out = _folder(options.out)
        feed = None
        if options.truth_feed is not None:
            feed = FeedSender(options.truth_feed)
            stack.callback(feed.close)
        truth = None
        if out is not None:
            truth = LineLog(out / "truth.csv", TRUTH_COLUMNS)
            stack.callback(truth.close)
        plant = _device(options, scenario, faults, feed, truth, clock, stack, start_foreign)
        executives = [plant.executive]
        if options.line_radio is not None:
            executives.append(feed_of(options, scenario.line.name, plant.world, clock, stack))
        if options.priority:
            enter_realtime(options.priority)
            garbage = Task("garbage", GARBAGE_MS, collect_garbage, offset_ms=GARBAGE_MS)
            executives.append(Executive([garbage], clock.now_ns()))
        end_ns = None
        if options.duration_s is not None:
            end_ns = clock.now_ns() + round(options.duration_s * NS_PER_S)
        words = TrainNotices(plant)

        def until(now_ns: int) -> bool:
            words.tell()
            return ending.asked or (end_ns is not None and now_ns >= end_ns)

        run(executives, clock, until)
        plant.stop(clock.now_ns())
        if (foreign := plant.world.foreign) is not None:
            foreign.stop()
            plant.pass_on(foreign, clock.now_ns())
        words.say_end()
    if out is not None and truth is not None:
        summary = {**summarise(plant, feed), "lost_log_lines": truth.lost_lines}
        write_whole(out / "plant.json", json.dumps(summary, indent=2) + "\n")
        if truth.lost_lines:
            _complain(loss_text(truth.lost_lines))
            return EXIT_ENVIRONMENT
    return ending.exit_code


def _device(
    options: argparse.Namespace,
    scenario: TrainScenario,
    faults: Sequence[FaultPlan],
    feed: FeedSender | None,
    truth: LineLog | None,
    clock: WallClock,
    stack: ExitStack,
    start_foreign: StartForeign | None,
) -> PlantDevice:
    """Open all ports and print what the plant serves. The stack closes the ports."""
    spec = chosen_bus(options.bus)
    refuse_second_plant(spec, clock, desk_elsewhere=scenario.desk_elsewhere)
    can = open_can(spec, clock=clock, node="PLANT", accept_ids=_wanted_ids(scenario))
    stack.callback(can.close)
    foreign = None
    if start_foreign is not None:
        foreign = start_foreign(scenario, spec, clock, stack)
        check_provided(faults, foreign)
    say(
        f"{scenario.train.name} at {scenario.start.name} on {scenario.line.name}, seed "
        f"{scenario.seed}, authority to {scenario.destination.name}"
    )
    say(f"bus: {spec}")
    _say_what_is_told(faults, feed)
    stack.callback(rendezvous.withdraw, parse_spec(spec).name)
    tags = open_tags(options.tags, spec, stack)
    radio: RadioPort = SilentRadio()
    if options.radio != AUTO or options.line_radio is None:
        radio = open_wayside(options.radio, scenario.line, spec, clock, stack)

    def shared_port(node: Node, ids: Collection[int]) -> CanPort:
        return can

    start_ns = clock.now_ns()
    by_hand = _by_hand(options, scenario, start_ns, stack)
    plant = PlantDevice(
        scenario,
        open_port=shared_port,
        tags=tags,
        radio=radio,
        truth=truth,
        start_ns=start_ns,
        epoch_offset_ns=clock.epoch_offset_ns,
        faults=faults,
        observer=None if feed is None else feed.truth,
        foreign=foreign,
        desk=by_hand.desk,
        by_hand=by_hand.faults,
    )
    if feed is not None:
        plant.schedule.listen(feed.change)
    return plant


def _check_by_hand(options: argparse.Namespace) -> None:
    """Raise SettingsError if --by-hand does not fit the other options."""
    if options.by_hand and options.out is None:
        raise SettingsError("--by-hand: needs --out, the folder of its files")
    operated = options.desk in ELSEWHERE or options.driver or options.desk_recording
    if DESK in options.by_hand and operated:
        raise SettingsError("--by-hand desk: another operates the desk; leave one of them out")


def _by_hand(
    options: argparse.Namespace, scenario: TrainScenario, start_ns: int, stack: ExitStack
) -> TrainByHand:
    """Open the files of --by-hand. Raises OSError."""
    if not options.by_hand:
        return TrainByHand()
    return open_by_hand(
        Path(options.out),
        tuple(options.by_hand),
        stack,
        mode=scenario.desk_mode,
        start_ns=start_ns,
        targets=targets_of(scenario),
        places=frozenset(FaultPlace) - BENCH_PLACES,
    )


def _say_what_is_told(faults: Sequence[FaultPlan], feed: FeedSender | None) -> None:
    """Report faults of bus and controller, which the plant cannot apply itself."""
    for plan in faults:
        if plan.kind.place in BENCH_PLACES:
            told = "the truth feed reports when to apply it" if feed else "no component applies it"
            say(f"fault {plan.index}, {plan.kind.name}: not applied by the plant; {told}")


def _wanted_ids(scenario: TrainScenario) -> frozenset[int]:
    """Identifiers that the shared port of all nodes receives: commands, and display frames for a
    driver model.
    """
    if scenario.driver is None:
        return COMMAND_IDS
    return COMMAND_IDS | {can_id(kind) for kind in DISPLAYED}


def _folder(out: str | None) -> Path | None:
    if out is None:
        return None
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _complain(words: object) -> None:
    print(f"plant: {words}", file=sys.stderr, flush=True)
