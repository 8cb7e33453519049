"""`hil from-log`: makes a scenario of a recorded ride."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metro_hil.cli.hil.working import number
from metro_hil.engine.errors import EngineError, UsageError
from metro_hil.model.run_options import EXIT_FAILED, EXIT_OK
from metro_hil.model.terminal import console_for

if TYPE_CHECKING:
    import canlog
    from metro_hil.from_log.run import FittedRide, Resimulated

SHOWN_MAX = 8


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "from-log",
        help="make a scenario of a recorded ride, and compare the simulation with the record",
        description="Read a log of this project's bus, fit load, odometer, running resistance and "
        "service brake of the train to the ride, write a scenario for `hil run`, simulate it, and "
        "report where the controller first decides otherwise than in the record. Exit code 0 if "
        "it never does and the case passes, 1 if not.",
    )
    parser.add_argument("log", metavar="LOG", help="log in any format that canlog reads")
    parser.add_argument("--channel", metavar="NAME", help="channel of the log; default: all")
    parser.add_argument(
        "--format", metavar="NAME", help="format of the log; default: by suffix and content"
    )
    for name, meaning in (
        ("line", "line of the ride; LINE:down is the other direction"),
        ("consist", "train of the ride, whose other values stay"),
        ("params", "what the controller believes of its train"),
    ):
        default = "florence" if name == "line" else "florence4"
        parser.add_argument(
            f"--{name}", default=default, metavar="NAME|FILE", help=f"{meaning}; default: {default}"
        )
    parser.add_argument(
        "--seed", type=number(0), default=1, metavar="N", help="seed of the scenario; default: 1"
    )
    parser.add_argument(
        "--tolerance",
        type=_percent,
        default=5.0,
        metavar="PERCENT",
        help="of a signal's recorded range, by which the simulation may differ; default: 5",
    )
    parser.add_argument(
        "--window",
        type=_seconds,
        default=1.0,
        metavar="S",
        help="time by which the simulation may be early or late; default: 1",
    )
    parser.add_argument("--out", metavar="DIR", help="default: a new folder below runs/")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Exit code 0 if simulation and record agree and the case is as expected."""
    from firmware_py.arguments import of_file
    from firmware_py.clock.clock import WallClock
    from metro_hil.from_log.run import fit_log, leave_scenario, resimulate
    from metro_hil.from_log.scenario import ChosenFiles
    from metro_hil.model.case import as_expected
    from metro_hil.model.run_folder import make_run_folder

    log = _log(options)
    files = ChosenFiles(options.line, options.consist, options.params)
    fitted = fit_log(log, files, seed=options.seed)
    words = f"from-log_{fitted.stations.start.name}-{fitted.stations.stops[-1].name}"
    folder = make_run_folder(options.out, WallClock().epoch_ns(), words).path
    try:
        path = leave_scenario(folder, fitted)
    except OSError as error:
        raise EngineError(of_file(error)) from error
    done = resimulate(
        path,
        fitted,
        folder / "simulated",
        tolerance_ratio=options.tolerance / 100.0,
        window_s=options.window,
    )
    if options.json:
        print(_json(path, fitted, done))
    else:
        _tell(path, fitted, done)
    agrees = not done.comparison.first and as_expected(done.case, done.result)
    return EXIT_OK if agrees else EXIT_FAILED


def _log(options: argparse.Namespace) -> "canlog.Log":
    """Read the log. Raises UsageError."""
    import canlog

    channels = (options.channel,) if options.channel else ()
    try:
        return canlog.read(
            options.log,
            options=canlog.ReadOptions(format=options.format, channels=channels, refuse_empty=True),
        )
    except canlog.LogError as error:
        raise UsageError(str(error)) from error


def _tell(path: Path, fitted: "FittedRide", done: "Resimulated") -> None:
    from metro_hil.cli.hil.verdicts import tell_scenario

    ride, stations, fit = fitted.ride, fitted.stations, fitted.fit
    end = "arrived" if stations.arrived else "not arrived at the end of the log"
    load = "not recorded" if fitted.load_ratio is None else f"{fitted.load_ratio:g}"
    text = [
        f"{ride.path}: {ride.duration_ns / 1e9:.1f} s, {ride.distance_m:.1f} m by odometer",
        f"ride       {stations.start.name} to {', '.join(each.name for each in stations.stops)}, "
        f"{end}",
        f"load       {load}",
        f"odometer   error {fitted.odometer_error_ratio:+.3%}",
    ]
    for key, value in fit.values.items():
        unseen = "  (this ride does not show it; the middle of the consist's range)"
        text.append(f"{key:<27} {value:g}{unseen if key in fit.unseen else ''}")
    text += [
        f"odometer of the fitted train under the recorded commands: {fit.after_m:.2f} m off (rms), "
        f"{fit.worst_m:.2f} m at most; before the fit {fit.before_m:.2f} m",
        "",
    ]
    sys.stdout.write("".join(f"{line}\n" for line in text))
    tell_scenario(console_for(), [done.case], [done.result], {})
    sys.stdout.write("".join(f"{line}\n" for line in _divergence(fitted, done)))
    print(f"simulated: {path.parent / 'simulated'}")
    print(f"scenario: {path}")


def _divergence(fitted: "FittedRide", done: "Resimulated") -> list[str]:
    comparison, left_s = done.comparison, fitted.ride.left_ns / 1e9
    text = [
        f"leaves at {left_s:.2f} s in the record, at {done.ride.left_ns / 1e9:.2f} s in the "
        "simulation; times below count from there"
    ]
    compared = f"{comparison.signals} signals of the controller over {comparison.compared_s:.1f} s"
    if not comparison.first:
        return [*text, f"no divergence: {compared}"]
    text.append(f"{len(comparison.first)} of {compared} diverge:")
    for each in comparison.first[:SHOWN_MAX]:
        text.append(
            f"  {each.at_s:8.3f} s  {each.message}.{each.signal}  recorded {each.recorded}, "
            f"simulated {each.simulated}"
        )
    if (more := len(comparison.first) - SHOWN_MAX) > 0:
        text.append(f"  {more} more signals later")
    return text


def _json(path: Path, fitted: "FittedRide", done: "Resimulated") -> str:
    import msgspec

    document: dict[str, Any] = {
        "scenario": str(path),
        "start": fitted.stations.start.name,
        "stops": [each.name for each in fitted.stations.stops],
        "arrived": fitted.stations.arrived,
        "load_ratio": fitted.load_ratio,
        "odometer_error": fitted.odometer_error_ratio,
        "real": fitted.real,
        "unseen": fitted.fit.unseen,
        "odometer_before_m": fitted.fit.before_m,
        "odometer_after_m": fitted.fit.after_m,
        "comparison": done.comparison,
        "result": done.result,
    }
    return msgspec.json.encode(document).decode()


def _percent(text: str) -> float:
    return _number_in(text, 100.0, "percentage")


def _seconds(text: str) -> float:
    return _number_in(text, 60.0, "number of seconds")


def _number_in(text: str, most: float, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= most:
        raise argparse.ArgumentTypeError(f"{text} is no {what} from 0 to {most:g}")
    return value
