"""Replays a run folder and finds where the controller differs from the recording."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any, Final

from firmware_py.clock.clock import NS_PER_S
from firmware_py.settings import override
from firmware_py.tag_reader.telegram import TelegramParser
from metro_hil.model.case import ControllerSpec
from metro_hil.replay.compare import Counts, ReplayComparison, ReplayDifference, compare, placed
from metro_hil.replay.log_rerun import SHIPPED, Rerun, maker, rerun
from metro_hil.replay.meaning import (
    chunk_words,
    frame_words,
    message_words,
    name_of,
    signals_of,
)
from metro_hil.replay.recording import Output, RecordedStep, Segment, cycles, read_recording
from metro_hil.replay.result import (
    CycleInputs,
    Divergence,
    HeardInput,
    KeyCounts,
    ReplayResult,
    ReplaySignalDifference,
)

CONTEXT: Final = 3


def replay_run(
    folder: Path,
    *,
    controller: ControllerSpec = SHIPPED,
    believed: Mapping[str, Any] | None = None,
    tolerance_s: float = 0.0,
    context: int = CONTEXT,
) -> ReplayResult:
    """Feed the recording of a run folder to a controller and compare its outputs.

    Args:
        folder: run folder, or the file `ports.log` itself.
        controller: the controller to run; another version or program instead of this one.
        believed: changes to the parameters, by dotted key.
        tolerance_s: greatest time difference of equal outputs.
        context: number of cycles, up to that of the first difference, whose inputs are given.

    Raises:
        RecordingError: if there is no recording, or it is damaged.
        SettingsError: for an impossible change of a parameter.
        ControllerStartError: if the other program cannot start.
    """
    recording = read_recording(folder)
    make = maker(controller)
    first: Divergence | None = None
    totals: dict[tuple[str, str], Counts] = {}
    notes: list[str] = []
    if not recording.complete:
        notes.append("the recorder was killed; its last step is left out")
    for number, segment in enumerate(recording.segments):
        commission = segment.commission
        if believed:
            config = override(commission.config, believed, "believed")
            commission = replace(commission, config=config)
        run = rerun(segment, make, commission)
        if run.died:
            notes.append(_death(segment, run))
        comparison = _compared(segment, run, round(tolerance_s * NS_PER_S), controller)
        _add(totals, comparison)
        if first is None and comparison.first is not None:
            first = _divergence(number, segment, comparison.first, context)
    names = _names(recording.segments)
    heard = _heard_counts(recording.segments)
    return ReplayResult(
        recording=str(recording.path),
        identical=first is None,
        controllers=len(recording.segments),
        cycles=sum(1 for segment in recording.segments for _ in cycles(segment)),
        heard_frames=heard["frames"],
        heard_chunks=heard["chunks"],
        heard_messages=heard["messages"],
        counts=tuple(_key_counts(key, totals[key], names) for key in sorted(totals)),
        first=first,
        notes=tuple(notes),
    )


def _compared(
    segment: Segment, run: Rerun, tolerance_ns: int, controller: ControllerSpec
) -> ReplayComparison:
    steps = segment.steps
    recorded = placed(steps, (step.outputs for step in steps))
    # The shipped controller gets the recorded execution times, so it measures the same; others not.
    mask = not segment.virtual and controller.kind != SHIPPED.kind
    return compare(recorded, placed(steps, run.outputs), tolerance_ns=tolerance_ns, mask=mask)


def _death(segment: Segment, run: Rerun) -> str:
    at = len(run.outputs) - 1
    at_s = (segment.steps[at].begin_ns - segment.commission.start_ns) / NS_PER_S
    last = " where the recording ends, too" if at == len(segment.steps) - 1 else ""
    return f"the controller ended by itself at {at_s:.3f} s{last}: {run.died}"


def _add(totals: dict[tuple[str, str], Counts], comparison: ReplayComparison) -> None:
    for key, counts in comparison.counts.items():
        total = totals.setdefault(key, Counts())
        total.same += counts.same
        total.masked += counts.masked
        total.changed += counts.changed
        total.missing += counts.missing
        total.extra += counts.extra


def _names(segments: Sequence[Segment]) -> dict[tuple[str, str], str]:
    found: dict[tuple[str, str], str] = {}
    for segment in segments:
        for step in segment.steps:
            for output in step.outputs:
                if (output.wire, output.key) not in found:
                    found[output.wire, output.key] = name_of(output)
    return found


def _key_counts(
    key: tuple[str, str], counts: Counts, names: Mapping[tuple[str, str], str]
) -> KeyCounts:
    wire, word = key
    return KeyCounts(
        wire=wire,
        key=word,
        name=names.get(key) or name_of(Output(wire, word, b"")),
        same=counts.same,
        masked=counts.masked,
        changed=counts.changed,
        missing=counts.missing,
        extra=counts.extra,
    )


def _heard_counts(segments: Sequence[Segment]) -> Counter[str]:
    counts: Counter[str] = Counter()
    for segment in segments:
        for step in segment.steps:
            counts["frames"] += len(step.frames)
            counts["chunks"] += len(step.chunks)
            counts["messages"] += len(step.messages)
    return counts


def _divergence(
    number: int, segment: Segment, difference: ReplayDifference, context: int
) -> Divergence:
    one, other = difference
    at = one or other
    assert at is not None
    start_ns = segment.commission.start_ns
    cycle = max(0, sum(1 for index, _ in cycles(segment) if index <= at.step) - 1)
    kind = "changed" if one and other else "missing" if one else "extra"
    return Divergence(
        controller=number,
        cycle=cycle,
        at_s=(at.at_ns - start_ns) / NS_PER_S,
        task=segment.steps[at.step].task,
        wire=at.output.wire,
        key=at.output.key,
        name=name_of(at.output),
        kind=kind,
        recorded=None if one is None else one.output.data.hex().upper(),
        replayed=None if other is None else other.output.data.hex().upper(),
        signals=_signal_differences(difference),
        inputs=_inputs(segment, cycle, context),
    )


def _signal_differences(difference: ReplayDifference) -> tuple[ReplaySignalDifference, ...]:
    one, other = difference
    if one is None or other is None:
        return ()
    mine, theirs = signals_of(one.output), signals_of(other.output)
    return tuple(
        ReplaySignalDifference(name, mine.get(name, "none"), theirs.get(name, "none"))
        for name in dict.fromkeys((*mine, *theirs))
        if mine.get(name) != theirs.get(name)
    )


def _inputs(segment: Segment, last: int, context: int) -> tuple[CycleInputs, ...]:
    """Inputs of the cycles up to `last`. The telegram parser needs all bytes from the first on."""
    parser, told = TelegramParser(), []
    for number, (_, step) in zip(count(), cycles(segment), strict=False):
        if number > last:
            break
        heard = _heard(parser, step, segment.commission.start_ns)
        if number > last - context:
            at_s = (step.begin_ns - segment.commission.start_ns) / NS_PER_S
            told.append(CycleInputs(number, at_s, heard))
    return tuple(told)


def _heard(parser: TelegramParser, step: RecordedStep, start_ns: int) -> tuple[HeardInput, ...]:
    found = [(frame.stamp_ns, *frame_words(frame)) for frame in step.frames]
    found += [(chunk.stamp_ns, *chunk_words(parser, chunk)) for chunk in step.chunks]
    found += [(message.stamp_ns, *message_words(message)) for message in step.messages]
    return tuple(
        HeardInput((stamp_ns - start_ns) / NS_PER_S, name, meaning)
        for stamp_ns, name, meaning in sorted(found, key=lambda each: each[0])
    )
