"""Genuine traffic of one run: the controller's inputs in each step, and its answers."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

from firmware_py.handed_ports import HandedPorts
from firmware_py.ports import CanFrame, RadioMessage, SerialChunk
from metro_hil.model.mission import plan_journey
from metro_hil.model.run_folder import RunFolder
from metro_hil.model.run_options import parse
from metro_hil.proof.judge import Permits, permits
from metro_hil.replay.recording import STOP, RecordedStep, Segment, read_recording
from metro_hil.run.lockstep import run_lockstep
from vobc.process import Commission
from vobc.vocabulary import CycleOutput

CONTROL = "control"


@dataclass(frozen=True, slots=True)
class Genuine:
    """A run as the controller received it, and its answers to that alone."""

    commission: Commission
    steps: tuple[RecordedStep, ...]
    outputs: tuple[CycleOutput, ...]
    """Output after each step."""
    permits: tuple[Permits, ...]
    """Permissions of ATP after each step."""
    frames: tuple[CanFrame, ...]
    chunks: tuple[SerialChunk, ...]
    messages: tuple[RadioMessage, ...]


def ride(seed: int, *, start: str = "II", end: str = "III") -> Genuine:
    """Record a run in virtual time; then compute the answers to the record alone."""
    options = parse(["run", "--lockstep", "--seed", str(seed), "--from", start, "--to", end])
    with tempfile.TemporaryDirectory() as folder:
        run_lockstep(options, plan_journey(options), RunFolder(Path(folder)))
        (segment,) = read_recording(Path(folder)).segments
    return _answered(segment)


def _answered(segment: Segment) -> Genuine:
    steps = tuple(step for step in segment.steps if step.task != STOP)
    ports = HandedPorts()
    device = segment.commission.device(can=ports.can, tags=ports.tags, radio=ports.radio)
    outputs, permitted = [], []
    for step in steps:
        ports.hand(step.frames, step.chunks, step.messages)
        device.executive.run_next(step.begin_ns, step.execution_ns)
        ports.take()
        outputs.append(device.output)
        permitted.append(permits(device.verdict))
    return Genuine(
        commission=segment.commission,
        steps=steps,
        outputs=tuple(outputs),
        permits=tuple(permitted),
        frames=tuple(frame for step in steps for frame in step.frames),
        chunks=tuple(chunk for step in steps for chunk in step.chunks),
        messages=tuple(message for step in steps for message in step.messages),
    )
