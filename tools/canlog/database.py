"""Reads files that describe a bus: DBC with our own reader, KCD, SYM and ARXML with cantools."""

import functools
from collections.abc import Iterable, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any, Final

from canlog.bus_model import (
    DEFAULT_BAUDRATE,
    PROTECTION,
    TIMEOUT_PERIODS,
    Bus,
    MessageSpec,
    SignalSpec,
)
from canlog.damage import Damages, LogError
from canlog.dbc_text import bus_of_text, dbc_text
from canlog.frames import KEY_EXTENDED

__all__ = ["Bus", "MessageSpec", "SignalSpec", "load_bus", "own_bus", "parse_bus"]

OWN_NAME: Final = "can_dbc"
"""Package that holds the DBC files of this project, and name of their bus."""
LAST: Final = "diagnostics.dbc"
"""The project's DBC file whose attributes and nodes apply to all of its files."""
BY_CANTOOLS: Final = (".kcd", ".sym", ".arxml")


def load_bus(dbc: "Path | str | Sequence[Path | str] | Bus | None" = None) -> Bus:
    """Return the bus of one or several files, or of this project if none is given.

    `can0=body.dbc` names a file for one channel only. `warnings` lists the flaws of DBC files.

    Raises:
        LogError: names the file that cannot be read or is not usable.
    """
    if isinstance(dbc, Bus):
        return dbc
    if dbc is None:
        return own_bus()
    given = [dbc] if isinstance(dbc, str | Path) else list(dbc)
    common: list[Bus] = []
    apart: dict[str, list[Bus]] = {}
    for each in given:
        channel, path = _channel_and_path(str(each))
        found = _loaded(path)
        (apart.setdefault(channel, []) if channel else common).append(found)
    everything = [*common, *(bus for buses in apart.values() for bus in buses)]
    joined = _joined(everything)
    if not apart:
        return joined
    by_channel = {name: _joined([*common, *buses]) for name, buses in apart.items()}
    by_channel[""] = _joined(common) if common else no_bus()
    return replace(joined, by_channel=by_channel)


def parse_bus(text: str, name: str = "DBC") -> Bus:
    """Return the bus that the text of a DBC file describes. Raises LogError."""
    found = bus_of_text(text, name)
    if found is None:
        raise LogError(f"{name}: not a usable DBC file: it has no statement of one")
    return found


@functools.cache
def own_bus() -> Bus:
    """Return the bus of this project."""
    entries = {each.name: each for each in resources.files(OWN_NAME).iterdir()}
    names = sorted(name for name in entries if name.endswith(".dbc") and name != LAST)
    files = [parse_bus(entries[name].read_text("ascii"), name) for name in [*names, LAST]]
    return replace(_joined(files), name=OWN_NAME, nodes=files[-1].nodes)


def no_bus() -> Bus:
    """Return a bus that defines no message."""
    return Bus("no DBC file", {}, {})


def _channel_and_path(text: str) -> tuple[str, Path]:
    channel, sign, rest = text.partition("=")
    if sign and channel and rest and "/" not in channel and not Path(text).exists():
        return channel, Path(rest)
    return "", Path(text)


def _loaded(path: Path) -> Bus:
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    if path.suffix.lower() in BY_CANTOOLS:
        return _by_cantools(path)
    return parse_bus(dbc_text(raw), str(path))


def _by_cantools(path: Path) -> Bus:
    # Keep python-can, which cantools imports for its tester, out of the program.
    from can_dbc.lean_cantools import put_off_tester

    put_off_tester()
    from cantools.database import load_file
    from cantools.database.can import Database

    try:
        database = load_file(str(path), strict=False)
    except Exception as error:
        # The parsers of cantools have no common base class for errors; each error concerns this
        # file.
        raise LogError(f"{path}: not usable: {error}") from error
    if not isinstance(database, Database):
        raise LogError(f"{path}: describes no CAN bus")
    return bus_of(database, str(path))


def _joined(buses: Sequence[Bus]) -> Bus:
    """Join the messages of several buses; the last one with an identifier wins, with a warning."""
    if len(buses) == 1:
        return buses[0]
    by_key: dict[int, MessageSpec] = {}
    warnings = [each for bus in buses for each in bus.warnings]
    again = Damages()
    for bus in buses:
        for key, spec in bus.by_key.items():
            if key in by_key and by_key[key] != spec:
                words = f"{by_key[key].name} and {spec.name} of {bus.name}; the last one counts"
                again.add("identifier in two files", "line", None, words)
            by_key[key] = spec
    rates = [bus.baudrate for bus in buses if bus.baudrate != DEFAULT_BAUDRATE]
    data_rates = [bus.data_baudrate for bus in buses if bus.data_baudrate]
    return Bus(
        name=", ".join(bus.name for bus in buses),
        messages=_by_name(by_key.values()),
        by_key=by_key,
        nodes={name: told for bus in buses for name, told in bus.nodes.items()},
        baudrate=rates[-1] if rates else DEFAULT_BAUDRATE,
        data_baudrate=data_rates[-1] if data_rates else 0,
        warnings=(*warnings, *map(str, again.all())),
    )


def _by_name(specs: Iterable[MessageSpec]) -> dict[str, MessageSpec]:
    return {spec.name: spec for spec in specs}


def bus_of(database: Any, name: str) -> Bus:
    """Convert a database that cantools has parsed."""
    definitions = database.dbc.attribute_definitions if database.dbc is not None else {}
    defaults = {
        name: definitions[name].default_value
        for name in PROTECTION
        if name in definitions and definitions[name].default_value not in (None, "")
    }
    specs = [_message(each, defaults) for each in database.messages]
    return Bus(
        name=name,
        messages={spec.name: spec for spec in specs},
        by_key={spec.key: spec for spec in specs},
        nodes={node.name: str(node.comment or "") for node in database.nodes},
        baudrate=_rate(database, "Baudrate") or DEFAULT_BAUDRATE,
        data_baudrate=_rate(database, "BaudrateCANFD"),
    )


def _rate(database: Any, name: str) -> int:
    attributes = database.dbc.attributes if database.dbc is not None else {}
    found = attributes.get(name)
    return int(found.value) if found is not None and found.value else 0


def _message(message: Any, defaults: dict[str, Any]) -> MessageSpec:
    period_ms = int(message.cycle_time or 0)
    attributes = message.dbc.attributes if message.dbc is not None else {}
    timeout = attributes.get("TimeoutMs") or attributes.get("E2ETimeout")
    protection = {name: attributes[name].value for name in PROTECTION if name in attributes}
    return MessageSpec(
        name=message.name,
        key=message.frame_id | (KEY_EXTENDED if message.is_extended_frame else 0),
        length=message.length,
        senders=tuple(message.senders),
        period_ms=period_ms,
        timeout_ms=int(timeout.value) if timeout else TIMEOUT_PERIODS * period_ms,
        is_fd=bool(message.is_fd),
        comment=str(message.comment or ""),
        signals=tuple(_signal(each) for each in message.signals),
        attributes={**defaults, **protection},
        optional=_may_be_absent(message, attributes),
        is_j1939=message.protocol == "j1939",
    )


def _may_be_absent(message: Any, attributes: Any) -> bool:
    """Whether the message may be absent although it is cyclic.

    GenMsgSendType ifActive or cyclicIfActive says so, or this project's attribute Optional.
    """
    optional = attributes.get("Optional")
    if_active = "ifactive" in str(message.send_type or "").lower()
    return if_active or (optional is not None and optional.value in (1, "yes"))


def _signal(signal: Any) -> SignalSpec:
    return SignalSpec(
        name=signal.name,
        start=signal.start,
        length=signal.length,
        big_endian=signal.byte_order == "big_endian",
        signed=signal.is_signed,
        is_float=signal.conversion.is_float,
        scale=signal.scale,
        offset=signal.offset,
        minimum=signal.minimum,
        maximum=signal.maximum,
        unit=signal.unit or "",
        choices={int(raw): str(name) for raw, name in (signal.choices or {}).items()},
        comment=str(signal.comment or ""),
        receivers=tuple(signal.receivers),
        is_multiplexer=signal.is_multiplexer,
        multiplexer=signal.multiplexer_signal,
        multiplexer_ids=tuple(signal.multiplexer_ids or ()),
    )
