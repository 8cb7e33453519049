"""`hil replay`: feeds recorded inputs to a controller and compares its outputs."""

import argparse
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metro_hil.engine.errors import UsageError
from metro_hil.model.run_options import EXIT_FAILED, EXIT_OK

if TYPE_CHECKING:
    from metro_hil.model.case import ControllerSpec
    from metro_hil.replay import ReplayResult
    from metro_hil.replay.result import CycleInputs, Divergence


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "replay",
        help="feed a recorded run to a controller again and compare its outputs",
        description="Feed the recorded inputs of a controller to a controller again, in virtual "
        "time, and compare its outputs frame by frame with the recorded ones. Exit code 0 if "
        "both are identical, 1 if they differ.",
    )
    parser.add_argument(
        "recording",
        nargs="?",
        metavar="RUN",
        help="folder of a run or part of its name, or its ports.log; default: the last run",
    )
    parser.add_argument(
        "--controller",
        default="shipped",
        metavar="WHICH",
        help="shipped, checkout:PATH (another version) or command:WORDS; default: shipped",
    )
    parser.add_argument(
        "--believed",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a parameter, such as ato.limits.accel_mps2=0.7; may be repeated",
    )
    parser.add_argument(
        "--tolerance",
        type=_milliseconds,
        default=0.0,
        metavar="MS",
        help="largest time difference between equal outputs; default: 0",
    )
    parser.add_argument(
        "--context", type=_count, default=3, metavar="N", help="show the inputs of N cycles"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Exit code 1 if the controller's outputs differ from the recording."""
    import msgspec

    from metro_hil.replay import replay_run

    result = replay_run(
        _recording(options.recording),
        controller=controller_of(options.controller),
        believed=_believed(options.believed),
        tolerance_s=options.tolerance / 1000.0,
        context=options.context,
    )
    if options.json:
        print(msgspec.json.encode(result).decode())
    else:
        sys.stdout.write("".join(f"{line}\n" for line in lines(result)))
    return EXIT_OK if result.identical else EXIT_FAILED


def _recording(word: str | None) -> Path:
    """Find the recorded run. Raises UsageError."""
    from canlog.damage import LogError
    from canlog.run_names import choose_run

    try:
        return choose_run(word, "hil")
    except LogError as error:
        raise UsageError(str(error)) from error


def controller_of(text: str) -> "ControllerSpec":
    """Parse the value of `--controller`. Raises UsageError."""
    from metro_hil.model.case import ControllerSpec

    kind, _, rest = text.partition(":")
    if text == "shipped":
        return ControllerSpec()
    if kind == "checkout" and rest:
        return ControllerSpec(kind=kind, path=rest)
    if kind == "command" and rest:
        return ControllerSpec(kind=kind, command=rest)
    raise UsageError(f"--controller {text}: shipped, checkout:PATH or command:WORDS is needed")


def _believed(changes: Sequence[str]) -> dict[str, Any]:
    believed: dict[str, Any] = {}
    for change in changes:
        key, equals, value = change.partition("=")
        if not equals or not key.strip():
            raise UsageError(f"--believed {change}: KEY=VALUE is needed")
        try:
            believed[key.strip()] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            raise UsageError(f"--believed {change}: {value!r} is no value of TOML") from None
    return believed


def lines(result: "ReplayResult") -> Sequence[str]:
    """The result as lines of text for a person."""
    text = [
        f"{result.recording}: {result.controllers} controller(s), {result.cycles} cycles; received "
        f"{result.heard_frames} frames, {result.heard_chunks} pieces of the tag reader's line, "
        f"{result.heard_messages} radio messages"
    ]
    text += [f"note: {note}" for note in result.notes]
    if result.first is None:
        masked = sum(each.masked for each in result.counts)
        but = f", {masked} of them apart from host timing" if masked else ""
        text.append(f"identical: all {result.compared} outputs are as recorded{but}")
        return text
    text.append(_differences(result))
    text += _divergence(result.first)
    return text


def _differences(result: "ReplayResult") -> str:
    parts = []
    for each in result.counts:
        words = [
            f"{number} {word}"
            for number, word in (
                (each.changed, "changed"),
                (each.missing, "missing"),
                (each.extra, "extra"),
            )
            if number
        ]
        if words:
            parts.append(f"{each.key} {each.name}: {', '.join(words)}")
    return "different: " + "; ".join(parts)


def _divergence(first: "Divergence") -> list[str]:
    which = f" of controller {first.controller}" if first.controller else ""
    text = [
        f"first in cycle {first.cycle}{which} at {first.at_s:.6f} s, task {first.task}: "
        f"{first.key} {first.name} {first.kind}",
        f"  recorded {first.recorded or 'nothing'}",
        f"  replayed {first.replayed or 'nothing'}",
    ]
    width = max((len(signal.name) for signal in first.signals), default=0)
    text += [
        f"  {signal.name:<{width}}  {signal.recorded} -> {signal.replayed}"
        for signal in first.signals
    ]
    for cycle in first.inputs:
        text += _cycle(cycle)
    return text


def _cycle(cycle: "CycleInputs") -> list[str]:
    text = [f"cycle {cycle.cycle} at {cycle.at_s:.6f} s received"]
    text += [f"  {heard.at_s:.6f} s  {heard.name}: {heard.meaning}" for heard in cycle.heard]
    return text if cycle.heard else [f"{text[0]} nothing"]


def _milliseconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 1e6:
        raise argparse.ArgumentTypeError(f"{text} is not a number of milliseconds")
    return value


def _count(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text} is not a whole number of 0 or more")
    return int(text)
