"""An FMU as a plant: inputs and frames in, one step, truth and frames out."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from can_dbc.binding import Frame, binding_of, kinds, message, sender
from can_dbc.codec import Decoder, Encoder, Rejected
from can_dbc.diagnostics import HEARTBEATS, NodeState
from can_dbc.nodes import Node
from firmware_py.settings import SettingsError
from metro_hil.foreign_plant.fmu import Fmu, FmuError
from metro_hil.foreign_plant.mapping import PlantMapping, Values, read_keys, read_mapping
from metro_hil.foreign_plant.plant_terminal import PlantTerminal
from metro_hil.foreign_plant.terminal_node import members_of
from plant_emulator.wire import GRID_MS, PLANT_NODES, ROUND_MS, timetable

NS_PER_S: Final = 1_000_000_000
BOOTING_STEPS: Final = ROUND_MS // GRID_MS
"""Number of steps in which the heartbeats say that the nodes start, as those of the bench do."""


class FmuPlant:
    """The FMU of a mapping file with the frames of its nodes."""

    def __init__(self, path: Path, told: Mapping[str, Any]) -> None:
        """Load and start the FMU. Raises SettingsError or FmuError.

        Args:
            path: the mapping file.
            told: content of hello.
        """
        self._start = _start_values(told)
        keys = read_keys(path)
        self._fmu = Fmu(path.parent / keys.fmu, events=bool(keys.terminal))
        self._node: PlantTerminal | None = None
        self.first: tuple[list[tuple[int, str]], list[str]] = ([], [])
        """Frames and serial bytes that its nodes send at the start."""
        try:
            self.mapping = mapping = read_mapping(
                path, list(self._fmu.variables), list(self._start)
            )
            self._check(mapping, str(path))
            self._prepare()
            for name, term in mapping.parameters.items():
                self._fmu.set(name, _value(term, self._start, f"parameters.{name}"))
            self._now_ns = int(told["start_ns"])
            self._fmu.start(self._now_ns / NS_PER_S)
            if mapping.terminal:
                members = members_of(self._fmu, mapping.terminal, str(path))
                also = (mapping.serial,) if mapping.serial else ()
                self._node = PlantTerminal(self._fmu, members, also)
                self._node.begin(self._now_ns)
                self.first = _outputs(self._node)
        except BaseException:
            self._fmu.close()
            raise

    def _prepare(self) -> None:
        mapping = self.mapping
        self._signals: dict[str, float] = dict.fromkeys(mapping.signals(), 0.0)
        names = {name.partition(".")[0] for name in self._signals}
        received = [kind for kind in kinds() if message(kind).name in names]
        self._decoder = Decoder(received) if received else None
        terms = [*mapping.truth.values()]
        for frame in mapping.frames.values():
            terms += frame.values()
        self._read = sorted({name for term in terms for name in term.names})
        absent = frozenset(PLANT_NODES) - mapping.nodes
        self._slots = timetable(absent)
        self._encoder = Encoder(dict.fromkeys(each.kind for slot in self._slots for each in slot))
        self._steps = 0

    def _check(self, mapping: PlantMapping, source: str) -> None:
        for table in ("parameters", "inputs"):
            for name in getattr(mapping, table):
                self._fmu.check(name, f"{source}: {table}.{name}")
        for key, term in mapping.truth.items():
            for name in term.names:
                self._fmu.check(name, f"{source}: truth.{key}")

    @property
    def provides(self) -> tuple[str, ...]:
        nodes = tuple(node.name for node in sorted(self.mapping.nodes))
        return (*(("motion",) if self.mapping.moves else ()), *nodes)

    def step(
        self, now_ns: int, inputs: Values, frames: Sequence[tuple[int, int, str]]
    ) -> tuple[dict[str, float], list[tuple[int, str]], list[str]]:
        """Advance the FMU to `now_ns`; return its truth, its frames and its serial bytes.

        Raises FmuError.
        """
        self._receive(frames)
        known = {**inputs, **self._signals}
        for name, term in self.mapping.inputs.items():
            self._fmu.set(name, _value(term, known, f"inputs.{name}"))
        if self._node is None:
            self._fmu.step(self._now_ns / NS_PER_S, (now_ns - self._now_ns) / NS_PER_S)
        else:
            heard = [(at_ns, can_id, bytes.fromhex(data)) for at_ns, can_id, data in frames]
            self._node.advance(now_ns, heard)
        self._now_ns = now_ns
        self._steps += 1
        values = self._fmu.get(self._read)
        truth = {
            name: _value(term, values, f"truth.{name}") for name, term in self.mapping.truth.items()
        }
        if abs(truth.get("speed_mps", 1.0)) <= self.mapping.standstill_mps:
            truth["speed_mps"] = 0.0
        if self._node is not None:
            return truth, *_outputs(self._node)
        return truth, self._sent(values), []

    def _receive(self, frames: Sequence[tuple[int, int, str]]) -> None:
        if self._decoder is None:
            return
        for stamp_ns, can_id, data in frames:
            heard = self._decoder.decode(can_id, bytes.fromhex(data), stamp_ns)
            if heard is None or isinstance(heard, Rejected):
                continue
            name = message(type(heard)).name
            for signal in self._signals:
                if signal.partition(".")[0] == name:
                    self._signals[signal] = float(getattr(heard, signal.partition(".")[2]))

    def _sent(self, values: Values) -> list[tuple[int, str]]:
        sent: list[tuple[int, str]] = []
        for sending in self._slots[self._steps % len(self._slots)]:
            frame = self._frame(sending.kind, values)
            sent += [(can_id, data.hex()) for can_id, data in self._encoder.encode(frame)]
        return sent

    def _frame(self, kind: type[Frame], values: Values) -> Frame:
        node = Node[sender(kind)]
        if kind is HEARTBEATS[node]:
            life = NodeState.BOOT_UP if self._steps < BOOTING_STEPS else NodeState.OPERATIONAL
            return HEARTBEATS[node](life)
        name = message(kind).name
        terms = self.mapping.frames[name]
        fields = {
            each.name: _as(
                each.kind, _value(terms[each.name], values, f"frames.{name}.{each.name}")
            )
            for each in binding_of(kind).fields
        }
        try:
            return kind(**fields)
        except ValueError as error:
            raise FmuError(f"frames.{name}: {error}") from error

    def close(self) -> None:
        self._fmu.close()


def _outputs(node: PlantTerminal) -> tuple[list[tuple[int, str]], list[str]]:
    """Frames and serial bytes of a node as the messages have them. Raises FmuError."""
    serial: list[str] = []
    for text in node.all_texts:
        try:
            serial += msgspec.json.decode(b"[" + text + b"]", type=list[str])
        except msgspec.MsgspecError as error:
            raise FmuError(f"serial: {error}") from error
    return [(can_id, data.hex()) for can_id, data in node.frames], serial


def _start_values(told: Mapping[str, Any]) -> dict[str, float]:
    """The numbers that parameters may use."""
    try:
        return {
            "front_m": float(told["front_m"]),
            "seed": float(told["seed"]),
            **{key: float(value) for key, value in told["train"].items()},
        }
    except (KeyError, TypeError, ValueError) as error:
        raise SettingsError(f"hello: {error}") from error


def _value(term: Any, known: Values, where: str) -> float:
    try:
        return float(term.value(known))
    except ZeroDivisionError:
        raise FmuError(f"{where}: division by zero") from None


def _as(hint: type[Any], value: float) -> Any:
    """The value in the type of a frame's field. Raises FmuError."""
    if hint is float:
        return value
    if hint is bool:
        return value != 0.0
    try:
        return hint(round(value))
    except (ValueError, OverflowError):
        raise FmuError(f"{value:g} is no {hint.__name__}") from None
