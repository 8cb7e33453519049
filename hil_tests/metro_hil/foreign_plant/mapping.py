"""The mapping file of an FMU: the variables for truth signals, inputs and signals of frames."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

from can_dbc.binding import binding_of, kinds, message, sender
from can_dbc.diagnostics import HEARTBEATS
from can_dbc.nodes import Node
from firmware_py import settings
from firmware_py.expression import ExpressionError, compile_expression
from firmware_py.grants import GrantProtocolError
from firmware_py.settings import SettingsError, nearest
from metro_hil.foreign_plant.checks import read_parts
from plant_emulator.foreign import INPUTS, MOTION, signals_of
from plant_emulator.wire import PHASES_MS

STANDSTILL_MAX_MPS: Final = 0.1
"""Largest `standstill_mps`: a train at this speed is still seen to move by the tachos."""

PATH: Final = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*|\[\d+(?:,\d+)*\])+")
"""A name with dots or indices, as `body.v` of a model or `MESSAGE.signal` of a frame."""
PLACEHOLDER: Final = "path_"

Values = Mapping[str, float]
"""Numbers by name."""


@dataclass(frozen=True, slots=True)
class MappingKeys:
    """Keys of a mapping file."""

    fmu: str
    """Path of the FMU, from the folder of the mapping file."""
    provides: tuple[str, ...] = (MOTION,)
    """Parts of the train that the FMU emulates: `motion` and names of nodes."""
    standstill_mps: float = 0.0
    """Speed up to which the train counts as standing, and its speed as 0."""
    terminal: str = ""
    """Network terminal of FMI-LS-BUS through which the nodes send and receive; empty: none."""
    serial: str = ""
    """Binary output with the tag reader's bytes as a list of hexadecimal JSON strings."""
    parameters: dict[str, str] = field(default_factory=dict)
    """Values of variables before the start: numbers, or expressions over the train's numbers."""
    inputs: dict[str, str] = field(default_factory=dict)
    """Values of input variables in each step: expressions over the bench's inputs, or
    `MESSAGE.signal` of a frame that the controller sends."""
    truth: dict[str, str] = field(default_factory=dict)
    """Truth signals: expressions over variables of the FMU."""
    frames: dict[str, dict[str, str]] = field(default_factory=dict)
    """Signals of the frames that the provided nodes send, by message."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.standstill_mps <= STANDSTILL_MAX_MPS:
            raise ValueError(
                f"standstill_mps {self.standstill_mps:g} is not within 0..{STANDSTILL_MAX_MPS:g}"
            )


@dataclass(frozen=True, slots=True)
class Term:
    """A number, a name, or an expression over names."""

    names: tuple[str, ...]
    """The names that it reads."""
    compute: Any
    """Returns the value for the values of its names."""

    def value(self, known: Values) -> float:
        """Evaluate it. Raises ZeroDivisionError."""
        return float(self.compute(known))


@dataclass(frozen=True, slots=True)
class PlantMapping:
    """A mapping file, checked against the train; `FmuPlant` checks it against the FMU."""

    fmu: Path
    moves: bool
    nodes: frozenset[Node]
    standstill_mps: float
    terminal: str
    serial: str
    parameters: Mapping[str, Term]
    inputs: Mapping[str, Term]
    truth: Mapping[str, Term]
    frames: Mapping[str, Mapping[str, Term]]

    def signals(self) -> tuple[str, ...]:
        """The frame signals that the inputs read, as `MESSAGE.signal`."""
        read = {name for term in self.inputs.values() for name in term.names}
        return tuple(sorted(read - set(INPUTS)))


def read_mapping(path: Path, variables: Collection[str], start: Collection[str]) -> PlantMapping:
    """Read a mapping file. Raises SettingsError that names file, line, key and value.

    Args:
        variables: names of the FMU's variables.
        start: names of the train's numbers, which parameters may use.
    """
    with settings.located(str(path), settings.text_of(path)):
        return _read_mapping(path, variables, start)


def _read_mapping(path: Path, variables: Collection[str], start: Collection[str]) -> PlantMapping:
    source = str(path)
    keys = read_keys(path)
    try:
        moves, nodes = read_parts(keys.provides)
    except GrantProtocolError as error:
        raise SettingsError(f"{source}: {error}") from error
    signals = signals_of(moves, nodes)
    for name in keys.truth:
        if name not in signals:
            hint = nearest(name, list(signals)) if signals else "its parts have no truth"
            raise SettingsError(f"{source}: truth.{name}: no signal of its parts; {hint}")
    for name in signals:
        if name not in keys.truth:
            raise SettingsError(f"{source}: truth.{name}: missing; its parts need this signal")
    for table in ("parameters", "inputs"):
        for name in getattr(keys, table):
            if name not in variables:
                hint = nearest(name, list(variables), "variable")
                raise SettingsError(f"{source}: {table}.{name}: no variable of the FMU; {hint}")
    if keys.terminal and keys.frames:
        raise SettingsError(f"{source}: frames: the nodes send through terminal {keys.terminal!r}")
    if keys.serial and not keys.terminal:
        raise SettingsError(f"{source}: serial: needs a terminal, whose clock it has")
    if keys.serial and keys.serial not in variables:
        hint = nearest(keys.serial, list(variables), "variable")
        raise SettingsError(f"{source}: serial: {keys.serial!r}: no variable of the FMU; {hint}")
    sources = (*INPUTS, *_received_signals())
    return PlantMapping(
        fmu=path.parent / keys.fmu,
        moves=moves,
        nodes=nodes,
        standstill_mps=keys.standstill_mps,
        terminal=keys.terminal,
        serial=keys.serial,
        parameters=_terms(keys.parameters, start, f"{source}: parameters"),
        inputs=_terms(keys.inputs, sources, f"{source}: inputs"),
        truth=_terms(keys.truth, variables, f"{source}: truth"),
        frames={} if keys.terminal else _frames(keys.frames, nodes, variables, source),
    )


def read_keys(path: Path) -> MappingKeys:
    """Read the keys of a mapping file. Raises SettingsError."""
    table = settings.parse(path)
    for name in ("parameters", "inputs", "truth", "frames"):
        if isinstance(table.get(name), dict):
            table[name] = _as_text(table[name])
    return settings.build(MappingKeys, table, str(path))


def _as_text(table: Mapping[str, Any]) -> dict[str, Any]:
    """The table with its numbers as the text of an expression."""
    return {
        key: _as_text(value)
        if isinstance(value, dict)
        else str(float(value))
        if isinstance(value, int | float)
        else value
        for key, value in table.items()
    }


def _terms(table: Mapping[str, str], allowed: Collection[str], where: str) -> dict[str, Term]:
    return {key: _term(value, allowed, f"{where}.{key}") for key, value in table.items()}


def _term(text: str, allowed: Collection[str], where: str) -> Term:
    """Read a name as it stands, or an expression over names. Raises SettingsError."""
    if text in allowed:
        return Term((text,), lambda known: known[text])
    named: dict[str, str] = {}

    def plain(match: re.Match[str]) -> str:
        """A word that an expression may hold, in place of a name with dots or indices."""
        name = match.group()
        if name not in allowed:
            raise SettingsError(f"{where}: {name}: {nearest(name, list(allowed), 'name')}")
        return named.setdefault(name, f"{PLACEHOLDER}{len(named)}")

    words = PATH.sub(plain, text)
    simple = [name for name in allowed if name.isidentifier()]
    try:
        expression = compile_expression(words, [*simple, *named.values()])
    except ExpressionError as error:
        raise SettingsError(f"{where}: {error}") from error
    back = {word: name for name, word in named.items()}
    names = {word: back.get(word, word) for word in sorted(expression.names)}
    return Term(
        tuple(names.values()),
        lambda known: expression(
            SimpleNamespace(**{word: known[name] for word, name in names.items()})
        ),
    )


def _received_signals() -> tuple[str, ...]:
    """Signals of the frames that the controller sends, as `MESSAGE.signal`."""
    return tuple(
        f"{message(kind).name}.{each.name}"
        for kind in kinds()
        if sender(kind) == Node.VOBC.name
        for each in binding_of(kind).fields
    )


def _frames(
    table: Mapping[str, Mapping[str, str]],
    nodes: Collection[Node],
    variables: Collection[str],
    source: str,
) -> dict[str, dict[str, Term]]:
    beats = set(HEARTBEATS.values())
    sent = {
        message(kind).name: kind
        for kind in PHASES_MS
        if Node[sender(kind)] in nodes and kind not in beats
    }
    for name in table:
        if name not in sent:
            hint = nearest(name, list(sent)) if sent else "it provides no node"
            raise SettingsError(f"{source}: frames.{name}: no frame of its nodes; {hint}")
    found: dict[str, dict[str, Term]] = {}
    for name, kind in sent.items():
        if name not in table:
            raise SettingsError(
                f"{source}: frames.{name}: missing; {sender(kind)} sends this frame"
            )
        where, signals = f"{source}: frames.{name}", table[name]
        fields = [each.name for each in binding_of(kind).fields]
        for signal in signals:
            if signal not in fields:
                raise SettingsError(f"{where}.{signal}: {nearest(signal, fields)}")
        if missing := [each for each in fields if each not in signals]:
            raise SettingsError(f"{where}.{missing[0]}: missing key")
        found[name] = _terms(signals, variables, where)
    return found
