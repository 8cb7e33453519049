"""Fuzzes a whole controller between its three ports, in one process and without waiting."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from firmware_py.handed_ports import HandedPorts
from firmware_py.ports import CanFrame
from metro_hil.proof.attacks import Attacker
from metro_hil.proof.genuine import Genuine
from metro_hil.proof.judge import Shadow, broken_rules, differences, permits
from vobc.process.device import VobcDevice

NOISE: Final = "noise"
REPLAY: Final = "replay"
FORGED: Final = "forged"
KINDS: Final = (NOISE, NOISE, NOISE, REPLAY, FORGED)
FRAMES_A_STEP: Final = {NOISE: 200, REPLAY: 20, FORGED: 20}
"""Mean number of attacking frames in a step. Noise may be much, because it must have no effect. Of
the others only the frames of one identifier remain, about one a step."""
CALM_RATIO: Final = 0.5
"""Share of the steps of a replay or forgery without an attack."""
LINE_RATIO: Final = 0.1
"""Share of the steps with garbage on the serial line or the radio."""
QUIET_STEPS: Final = 2
"""Number of steps between garbage and a telegram on the same line."""


@dataclass(slots=True)
class Episode:
    """One run under one kind of attack."""

    kind: str
    seed: int
    frames: int = 0
    """Number of attacking frames, telegrams and messages."""
    steps: int = 0
    lucky: int = 0
    problem: str = ""
    """First problem and its instant; empty if all rules held."""
    ended: Counter[str] = field(default_factory=Counter)
    """Number of steps by the state of supervision at their end."""


def episode(genuine: Genuine, kind: str, seed: int, *, frames_max: int) -> Episode:
    """Run once under attack, until the end of the run, the first problem, or enough frames."""
    told = Episode(kind, seed)
    attacker = Attacker(genuine, np.random.default_rng(seed))
    generator = np.random.default_rng([seed, 1])
    ports = HandedPorts()
    device = genuine.commission.device(can=ports.can, tags=ports.tags, radio=ports.radio)
    shadow = Shadow()
    busy = _busy_steps(genuine)
    frames_before = messages_before = chunks_before = 0
    # A latched emergency hides all later attacks, so each attack begins at another step.
    first = 0 if kind == NOISE else int(generator.integers(0, len(genuine.steps)))
    for number, step in enumerate(genuine.steps):
        attack: list[CanFrame] = []
        now_ns = step.begin_ns
        if kind == NOISE or (number >= first and generator.random() >= CALM_RATIO):
            count = int(generator.poisson(FRAMES_A_STEP[kind]))
            attack = _attack(attacker, kind, count, frames_before, now_ns)
        frames = _mixed(step.frames, attack, generator)
        attacker.heard(step.frames)
        chunks, messages = list(step.chunks), list(step.messages)
        if generator.random() < LINE_RATIO:
            if number not in busy:
                chunks.append(attacker.garbage(chunks_before, now_ns))
            messages.append(attacker.babble(messages_before, now_ns))
            told.frames += 2
        told.frames += len(attack)
        told.steps += 1
        ports.hand(frames, chunks, messages)
        problem = _ran(device, step.begin_ns, step.execution_ns)
        ports.take()
        output = device.output
        told.ended[output.supervision.name] += 1
        genuine_output = genuine.outputs[number]
        problems = [problem] if problem else list(broken_rules(output))
        if kind == NOISE:
            problems += differences(output, genuine_output)
        elif kind == REPLAY:
            got = permits(device.verdict)
            problems += shadow.more_permissive(now_ns, got, genuine.permits[number])
        frames_before += len(step.frames)
        messages_before += len(step.messages)
        chunks_before += len(step.chunks)
        if problems:
            told.problem = f"step {number} at {now_ns / 1e9:.3f} s: {'; '.join(problems)}"
            break
        if told.frames >= frames_max:
            break
    told.lucky = attacker.lucky
    return told


def _attack(attacker: Attacker, kind: str, count: int, before: int, now_ns: int) -> list[CanFrame]:
    if kind == NOISE:
        return attacker.noise(count, now_ns)
    if kind == REPLAY:
        return attacker.replayed(count, before, now_ns)
    return attacker.forged(count, now_ns)


def _mixed(
    genuine: list[CanFrame], attack: list[CanFrame], generator: np.random.Generator
) -> list[CanFrame]:
    """Insert the attack at random between the genuine frames, which keep their order."""
    mixed = list(attack)
    places = np.sort(generator.integers(0, len(attack) + 1, len(genuine))).tolist()
    for shift, (place, frame) in enumerate(zip(places, genuine, strict=True)):
        mixed.insert(place + shift, frame)
    return mixed


def _busy_steps(genuine: Genuine) -> frozenset[int]:
    """Return the steps in or near which the serial line carries a telegram."""
    return frozenset(
        number + near
        for number, step in enumerate(genuine.steps)
        if step.chunks
        for near in range(-QUIET_STEPS, QUIET_STEPS + 1)
    )


def _ran(device: VobcDevice, begin_ns: int, execution_ns: int) -> str:
    try:
        device.executive.run_next(begin_ns, execution_ns)
    except Exception as error:  # No input may make a controller raise an exception.
        return f"{type(error).__name__}: {error}"
    return ""
