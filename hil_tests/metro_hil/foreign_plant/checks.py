"""Checks what a foreign plant sends: its parts, its truth and its frames. Pure."""

import math
from collections.abc import Collection, Mapping
from functools import cache
from typing import Final

from can_dbc.binding import binding_of, kinds, sender
from can_dbc.nodes import Node
from firmware_py.grants import FRAME_BYTES_MAX, GrantProtocolError
from firmware_py.settings import nearest
from plant_emulator.foreign import LIMITS, MOTION, TRUTH_OF, signals_of
from plant_emulator.world import STEP_S

STEP_BITS: Final = 2500
"""Bits that the bus at 250 kbit/s carries in a step of 10 ms."""
WAITING_BITS_MAX: Final = 10 * STEP_BITS
"""Maximum length of all frames that wait for the bus. The mailboxes of a node would overflow
soon after."""
FRAME_BITS: Final = 47
"""Length of a frame without data and without stuffing, with its intermission."""
DRIFT_M: Final = 0.1
"""Largest difference between the movement of the front and that by the mean speed, m. It leaves
room for couplers and simple integration, and finds a steady error of 0.1 m/s."""
DRIFT_KEPT_RATIO: Final = 0.99
"""Share of the difference that counts on in the next step, so that about a second counts."""


def read_parts(provides: Collection[str]) -> tuple[bool, frozenset[Node]]:
    """Return whether the program moves the train, and its nodes. Raises GrantProtocolError."""
    if not provides:
        raise GrantProtocolError(f"provides: empty; it names parts of {', '.join(TRUTH_OF)}")
    for part in provides:
        if part not in TRUTH_OF:
            raise GrantProtocolError(f"provides: {part!r}: {nearest(part, list(TRUTH_OF))}")
    return MOTION in provides, frozenset(Node[part] for part in provides if part != MOTION)


class TruthCheck:
    """Checks the truth of one program, step by step."""

    def __init__(self, moves: bool, nodes: Collection[Node], front_m: float) -> None:
        self._names = signals_of(moves, nodes)
        self._moves = moves
        self._start_m: float | None = front_m
        self._front_m, self._speed_mps = front_m, 0.0
        self._drift_m = 0.0

    def checked(self, truth: Mapping[str, float | bool]) -> dict[str, float]:
        """Return the truth as numbers. Raises GrantProtocolError."""
        if len(truth) != len(self._names) or any(name not in truth for name in self._names):
            self._refuse_names(truth)
        values: dict[str, float] = {}
        for name in self._names:
            value = float(truth[name])
            low, high = LIMITS[name]
            if not low <= value <= high:
                raise GrantProtocolError(f"truth.{name}: {value:g} is not within {low:g}..{high:g}")
            values[name] = value
        if self._moves:
            self._check_motion(values["front_m"], values["speed_mps"])
        return values

    def _refuse_names(self, truth: Mapping[str, float | bool]) -> None:
        missing = [name for name in self._names if name not in truth]
        if missing:
            raise GrantProtocolError(f"truth.{missing[0]}: missing; its parts need this signal")
        name = next(name for name in truth if name not in self._names)
        what = nearest(name, list(self._names)) if self._names else "its parts report no truth"
        raise GrantProtocolError(f"truth.{name}: no signal of its parts; {what}")

    def _check_motion(self, front_m: float, speed_mps: float) -> None:
        if self._start_m is not None and math.fabs(front_m - self._start_m) > DRIFT_M:
            raise GrantProtocolError(
                f"truth.front_m: the train starts at {front_m:.3f} m; the case has it at "
                f"{self._start_m:.3f} m"
            )
        self._start_m = None
        mean_mps = 0.5 * (self._speed_mps + speed_mps)
        moved_m = front_m - self._front_m
        self._drift_m = DRIFT_KEPT_RATIO * self._drift_m + moved_m - mean_mps * STEP_S
        if not math.fabs(self._drift_m) <= DRIFT_M:
            raise GrantProtocolError(
                f"truth.front_m: moves by {moved_m:.3f} m in {STEP_S:g} s, but truth.speed_mps is "
                f"{mean_mps:.3f} m/s; check their units"
            )
        self._front_m, self._speed_mps = front_m, speed_mps


class LoadCheck:
    """Checks that the frames of the program fit on the bus."""

    def __init__(self) -> None:
        self._waiting_bits = 0

    def offer(self, frames: Collection[bytes]) -> None:
        """Take the data of the frames of one step. Raises GrantProtocolError."""
        bits = sum(FRAME_BITS + 8 * len(data) for data in frames)
        self._waiting_bits = max(0, self._waiting_bits + bits - STEP_BITS)
        if self._waiting_bits > WAITING_BITS_MAX:
            raise GrantProtocolError(
                f"frames: it floods the bus, which carries {STEP_BITS} bits in a step; "
                f"{self._waiting_bits} bits wait"
            )


@cache
def _senders() -> Mapping[int, tuple[Node, str]]:
    """Node and name of each message of the DBC files, by identifier."""
    return {
        each.frame_id: (Node[sender(kind)], each.name)
        for kind in kinds()
        for each in binding_of(kind).messages
    }


def received_ids() -> frozenset[int]:
    """Identifiers that a foreign plant receives: all that no node of the train sends."""
    senders = _senders()
    ids = range(0x800)
    return frozenset(
        can_id for can_id in ids if can_id not in senders or senders[can_id][0] is Node.VOBC
    )


def read_frames(
    frames: Collection[tuple[int, str]], nodes: Collection[Node]
) -> list[tuple[Node, int, bytes]]:
    """Decode the frames of a yield, each with its sender. Raises GrantProtocolError."""
    senders, found = _senders(), []
    for can_id, text in frames:
        if can_id not in senders:
            raise GrantProtocolError(f"frames: no DBC file has a message {can_id:#05x}")
        node, name = senders[can_id]
        if node not in nodes:
            raise GrantProtocolError(
                f"frames: {can_id:#05x} is {name} of {node.name}, which it does not provide"
            )
        data = read_hex("frames", text)
        if len(data) > FRAME_BYTES_MAX:
            raise GrantProtocolError(f"frames: {can_id:#05x} has {len(data)} bytes, over 8")
        found.append((node, can_id, data))
    return found


def read_hex(where: str, text: str) -> bytes:
    """Decode hexadecimal text. Raises GrantProtocolError."""
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise GrantProtocolError(f"{where}: {text!r} is not hexadecimal") from None
