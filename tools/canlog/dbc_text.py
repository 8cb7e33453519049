"""Reads DBC files as they occur in practice: a flaw becomes a warning, and the rest is used."""

import bisect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from canlog.bus_model import (
    DEFAULT_BAUDRATE,
    PROTECTION,
    TIMEOUT_PERIODS,
    Bus,
    MessageSpec,
    SignalSpec,
)
from canlog.damage import EXTENDED_MAX, STANDARD_MAX, Damages, shown
from canlog.frames import KEY_EXTENDED
from canlog.source import UTF16_MARKS

NO_NODE: Final = "Vector__XXX"
ORPHANS: Final = "VECTOR__INDEPENDENT_SIG_MSG"
"""Pseudo-message of a DBC file for the signals that belong to no message."""
J1939_FORMAT: Final = "J1939PG"
FRAME_FORMATS: Final = (
    *("StandardCAN", "ExtendedCAN", "reserved", J1939_FORMAT),
    *("reserved",) * 10,
    *("StandardCAN_FD", "ExtendedCAN_FD"),
)
"""Names for the values of VFrameFormat in a file that defines it as a number."""
FLOAT_BITS: Final = {1: 32, 2: 64}
"""Length of a float signal by its SIG_VALTYPE_."""
PAGES_MAX: Final = 1 << 16
"""Maximum number of multiplexer values of one signal."""
SIGNAL_BITS_MAX: Final = 8 * 1785
"""Maximum length of a signal: the longest J1939 transport message has 1,785 bytes."""

_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_STRING: Final = r'"((?:\\"|[^"])*)"'
SKIPPED: Final = re.compile(r"(?:\s+|//[^\n]*|;)*")
KEYWORD: Final = re.compile(r"[A-Z][A-Z_]*")
PAIR: Final = re.compile(rf"({_NUMBER})\s*{_STRING}")
RANGE: Final = re.compile(r"(\d+)\s*-\s*(\d+)")
TEXT: Final = re.compile(_STRING)
STATEMENT: Final = re.compile(r'(?:[^;"]|"(?:\\"|[^"])*")*;')
LINE: Final = re.compile(r"[^\n]*")

SHAPES: Final[Mapping[str, re.Pattern[str]]] = {
    "VERSION": re.compile(rf"VERSION\s*{_STRING}"),
    "NS_": re.compile(r"NS_\s*:?(?:[ \t]*\r?\n[ \t]+\w+)*"),
    "BS_": re.compile(r"BS_\s*:[^\n]*"),
    "BU_": re.compile(r"BU_\s*:(?P<names>(?:\s+(?!(?:BO_|VAL_TABLE_|CM_|BA_DEF_)\s)\w+)*)"),
    "BO_": re.compile(
        r"BO_\s+(?P<id>\d+)\s+(?P<name>[^\s:]+)\s*:\s*(?P<length>\w+)(?:[ \t]+(?P<sender>\S+))?"
    ),
    "SG_": re.compile(
        r"SG_\s+(?P<name>[^\s:]+)(?:\s+(?P<mux>M|m\d+M?|m))?\s*:\s*(?P<start>\d+)\s*\|\s*(?P<length>\d+)"
        rf"\s*@\s*(?P<order>[01])\s*(?P<sign>[-+])\s*\(\s*(?P<scale>{_NUMBER})\s*,"
        rf"\s*(?P<offset>{_NUMBER})\s*\)\s*(?:\[\s*(?P<low>{_NUMBER})\s*\|\s*(?P<high>{_NUMBER})\s*\])?"
        r'[ \t]*(?:"(?P<unit>(?:\\"|[^"])*)")?(?P<receivers>[^\n]*)'
    ),
    "VAL_": re.compile(
        rf"VAL_\s+(?:(?P<id>\d+)\s+)?(?P<name>[^\s;]+)(?P<pairs>(?:\s*{_NUMBER}\s*\"(?:\\\"|[^\"])*\")*)"
        r"\s*(?:(?P<table>[^\s;\"]+)\s*;|;)?"
    ),
    "VAL_TABLE_": re.compile(
        rf"VAL_TABLE_\s+(?P<name>[^\s;]+)(?P<pairs>(?:\s*{_NUMBER}\s*\"(?:\\\"|[^\"])*\")*)\s*;"
    ),
    "CM_": re.compile(
        r"CM_\s*(?:(?P<kind>BO_|SG_|BU_|EV_)\s+(?P<of>[^\s\"]+)(?:\s+(?P<name>[^\s\"]+))?)?"
        rf"\s*{_STRING}\s*;?"
    ),
    "BA_": re.compile(
        rf"BA_\s*{_STRING}\s*(?:(?P<kind>BO_|SG_|BU_|EV_)\s+(?P<of>\S+)\s+)?"
        rf"(?:(?P<name>[^\s\";]+)\s+)??(?P<value>{_NUMBER}|\"(?:\\\"|[^\"])*\")\s*;"
    ),
    "BA_DEF_": re.compile(
        rf"BA_DEF_\s+(?:(?:BO_|SG_|BU_|EV_)\s*)?{_STRING}\s*(?P<type>\w+)(?P<rest>(?:[^;\"]|\"(?:\\\"|[^\"])*\")*);"
    ),
    "BA_DEF_DEF_": re.compile(
        rf"BA_DEF_DEF_\s+{_STRING}\s*(?P<value>{_NUMBER}|\"(?:\\\"|[^\"])*\")\s*;"
    ),
    "SIG_VALTYPE_": re.compile(
        r"SIG_VALTYPE_\s+(?P<id>\d+)\s+(?P<name>[^\s:]+)\s*:?\s*(?P<type>\d+)\s*;"
    ),
    "SG_MUL_VAL_": re.compile(
        r"SG_MUL_VAL_\s+(?P<id>\d+)\s+(?P<name>\S+)\s+(?P<selector>\S+)\s+(?P<ranges>[\d\s,-]+);"
    ),
    "BO_TX_BU_": re.compile(r"BO_TX_BU_\s+(?P<id>\d+)\s*:\s*(?P<names>[^;]*);"),
}
ENDED: Final = frozenset({"VAL_", "CM_"})
"""Statements that are also read if the closing semicolon is missing."""
IGNORED: Final = frozenset(
    {
        *("BA_DEF_REL_", "BA_REL_", "BA_DEF_DEF_REL_", "BA_DEF_SGTYPE_", "BA_SGTYPE_", "CAT_DEF_"),
        *("CAT_", "EV_", "EV_DATA_", "ENVVAR_DATA_", "FILTER", "NS_DESC_", "SGTYPE_", "SIG_GROUP_"),
        *("SGTYPE_VAL_", "SIG_TYPE_REF_", "SIGTYPE_VALTYPE_"),
    }
)
"""Statements that do not describe frames."""


@dataclass(slots=True)
class _Signal:
    """One SG_ line, and what later statements add to it."""

    found: re.Match[str]
    choices: dict[int, str] = field(default_factory=dict)
    comment: str = ""
    float_bits: int = 0
    selector: str | None = None
    pages: list[int] = field(default_factory=list)
    long_name: str = ""

    @property
    def name(self) -> str:
        return self.found["name"]

    @property
    def mux(self) -> str:
        """Multiplexer mark: M for a selector, m and a page number for what it selects.

        A bare m is taken as M.
        """
        told = self.found["mux"] or ""
        return "M" if told == "m" else told


@dataclass(slots=True)
class _Message:
    """One BO_ line with its signals, and what later statements add to it."""

    found: re.Match[str]
    key: int
    signals: list[_Signal] = field(default_factory=list)
    attributes: dict[str, Any] = field(default_factory=dict)
    comment: str = ""
    more_senders: list[str] = field(default_factory=list)

    def named(self, name: str) -> list[_Signal]:
        return [each for each in self.signals if each.name == name]


def dbc_text(raw: bytes) -> str:
    """Decode as UTF-8 or UTF-16 if it is that, or else as Windows-1252, as the format defines."""
    if raw[:2] in UTF16_MARKS:
        return raw.decode("utf-16", "replace")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("cp1252", "replace")


def bus_of_text(text: str, name: str, damages: Damages | None = None) -> Bus | None:
    """Return the bus that the text of a DBC file describes; None for a text without a DBC
    statement.

    Args:
        damages: receives every flaw with its line; all else is used.
    """
    reader = _Reader(text, Damages() if damages is None else damages)
    reader.read()
    return reader.bus(name) if reader.statements else None


class _Reader:
    """Goes through the statements of one file."""

    def __init__(self, text: str, damages: Damages) -> None:
        self._text, self._damages = text, damages
        self._breaks: list[int] | None = None
        self.statements = 0
        self._messages: list[_Message] = []
        self._by_id: dict[str, _Message] = {}
        """The last message with each identifier, by the identifier as written."""
        self._open: _Message | None = None
        """The message to which the following signals belong."""
        self._nodes: dict[str, str] = {}
        self._long_nodes: dict[str, str] = {}
        self._tables: dict[str, dict[int, str]] = {}
        self._defined: dict[str, Sequence[str]] = {}
        """Names of the values of each ENUM attribute, by its name; empty for other attributes."""
        self._defaults: dict[str, Any] = {}
        self._attributes: dict[str, Any] = {}
        self._orphans: set[str] = set()
        self._takers: Mapping[str, Callable[[re.Match[str]], None]] = {
            "BU_": self._take_nodes,
            "BO_": self._take_message,
            "SG_": self._take_signal,
            "VAL_": self._take_values,
            "VAL_TABLE_": self._take_table,
            "CM_": self._take_comment,
            "BA_": self._take_attribute,
            "BA_DEF_": self._take_definition,
            "BA_DEF_DEF_": self._take_default,
            "SIG_VALTYPE_": self._take_float,
            "SG_MUL_VAL_": self._take_pages,
            "BO_TX_BU_": self._take_senders,
        }

    def _line(self, at: int) -> int:
        if self._breaks is None:
            self._breaks = [each.start() for each in re.finditer("\n", self._text)]
        return bisect.bisect_left(self._breaks, at) + 1

    def _flaw(self, kind: str, at: int, words: str) -> None:
        self._damages.add(kind, "line", self._line(at), words)

    def read(self) -> None:
        """Read all statements in order; text that is no statement costs only its own line."""
        text, at = self._text, 0
        while True:
            skipped = SKIPPED.match(text, at)
            at = skipped.end() if skipped else at
            if at >= len(text):
                return
            at = self._statement(at)

    def _statement(self, at: int) -> int:
        """Read the statement that begins here, and return where it ends."""
        text = self._text
        word = KEYWORD.match(text, at)
        name = word[0] if word is not None else ""
        shape = SHAPES.get(name)
        if shape is not None:
            found = shape.match(text, at)
            if found is not None:
                self.statements += 1
                taker = self._takers.get(name)
                if taker is not None:
                    taker(found)
                if name in ENDED and not found[0].endswith(";"):
                    self._flaw("statement without its end", at, shown(found[0]))
                return found.end()
        elif name in IGNORED:
            found = STATEMENT.match(text, at)
            if found is not None:
                self.statements += 1
                return found.end()
        line = LINE.match(text, at)
        assert line is not None
        if name == "BO_":
            # The signals that follow belong to this message and to no other.
            self._open = None
        self._flaw("unreadable statement", at, shown(line[0].strip()))
        return line.end()

    def _take_nodes(self, found: re.Match[str]) -> None:
        self._nodes |= dict.fromkeys(found["names"].split(), "")

    def _take_message(self, found: re.Match[str]) -> None:
        text, name = found["id"], found["name"]
        self._open = None
        if name == ORPHANS:
            self._orphans.add(text)
            self._open = _Message(found, -1)
            return
        wide = int(text)
        identifier = wide & ~KEY_EXTENDED
        key = wide if wide > STANDARD_MAX else identifier
        if wide >= 1 << 32 or identifier > EXTENDED_MAX:
            self._flaw("impossible identifier", found.start(), f"{name}: {text}; left out")
            self._orphans.add(text)
            self._open = _Message(found, -1)
            return
        if not wide & KEY_EXTENDED and identifier > STANDARD_MAX:
            words = f"{name}: {text} has more than 11 bits; taken as one of 29 bits"
            self._flaw("identifier without bit 31", found.start(), words)
            key = identifier | KEY_EXTENDED
        if text in self._by_id:
            words = (
                f"{name}: {text} is also that of {self._by_id[text].found['name']}; this one counts"
            )
            self._flaw("duplicate identifier", found.start(), words)
        self._open = self._by_id[text] = _Message(found, key)
        self._messages.append(self._open)

    def _take_signal(self, found: re.Match[str]) -> None:
        if self._open is None:
            self._flaw("signal of no message", found.start(), found["name"])
        else:
            self._open.signals.append(_Signal(found))

    def _message_of(self, found: re.Match[str], text: str, what: str) -> _Message | None:
        message = self._by_id.get(text)
        if message is None and text not in self._orphans:
            self._flaw(f"stray {what}", found.start(), f"there is no message {text}")
        return message

    def _signals_of(self, found: re.Match[str], text: str, name: str, what: str) -> list[_Signal]:
        message = self._message_of(found, text, what)
        if message is None:
            return []
        signals = message.named(name)
        if not signals:
            words = f"{message.found['name']} has no signal {name}"
            self._flaw(f"stray {what}", found.start(), words)
        return signals

    def _take_values(self, found: re.Match[str]) -> None:
        if found["id"] is None:
            # The values belong to an environment variable.
            return
        choices = _pairs(found["pairs"])
        if found["table"]:
            choices = choices or self._tables.get(found["table"], {})
        for signal in self._signals_of(found, found["id"], found["name"], "VAL_"):
            signal.choices = choices or signal.choices

    def _take_table(self, found: re.Match[str]) -> None:
        self._tables[found["name"]] = _pairs(found["pairs"])

    def _take_comment(self, found: re.Match[str]) -> None:
        comment = _plain(found[4])
        if found["kind"] == "BU_":
            if found["of"] in self._nodes:
                self._nodes[found["of"]] = comment
        elif found["kind"] == "BO_":
            message = self._message_of(found, found["of"], "CM_")
            if message is not None:
                message.comment = comment
        elif found["kind"] == "SG_":
            for signal in self._signals_of(found, found["of"], found["name"] or "", "CM_"):
                signal.comment = comment

    def _take_attribute(self, found: re.Match[str]) -> None:
        name, value = found[1], _value(found["value"])
        if found["kind"] is None:
            self._attributes[name] = value
        elif found["kind"] == "BU_" and name == "SystemNodeLongSymbol":
            self._long_nodes[found["of"]] = str(value)
        elif found["kind"] == "BO_":
            message = self._message_of(found, found["of"], "BA_")
            if message is not None:
                message.attributes[name] = value
        elif found["kind"] == "SG_":
            for signal in self._signals_of(found, found["of"], found["name"] or "", "BA_"):
                if name == "SystemSignalLongSymbol" and value:
                    signal.long_name = str(value)

    def _take_definition(self, found: re.Match[str]) -> None:
        is_enum = found["type"] == "ENUM"
        self._defined[found[1]] = TEXT.findall(found["rest"]) if is_enum else ()

    def _take_default(self, found: re.Match[str]) -> None:
        self._defaults[found[1]] = _value(found["value"])

    def _take_float(self, found: re.Match[str]) -> None:
        for signal in self._signals_of(found, found["id"], found["name"], "SIG_VALTYPE_"):
            signal.float_bits = FLOAT_BITS.get(int(found["type"]), 0)

    def _take_pages(self, found: re.Match[str]) -> None:
        pages: list[int] = []
        for first, last in RANGE.findall(found["ranges"]):
            pages += range(int(first), min(int(last), int(first) + PAGES_MAX) + 1)
        for signal in self._signals_of(found, found["id"], found["name"], "SG_MUL_VAL_"):
            signal.selector, signal.pages = found["selector"], pages[:PAGES_MAX]

    def _take_senders(self, found: re.Match[str]) -> None:
        message = self._message_of(found, found["id"], "BO_TX_BU_")
        if message is not None:
            message.more_senders += found["names"].replace(",", " ").split()

    def bus(self, name: str) -> Bus:
        """Build the bus from all statements."""
        specs: dict[str, MessageSpec] = {}
        by_key: dict[int, MessageSpec] = {}
        for message in self._messages:
            spec = self._spec(message)
            if spec.name in specs and specs[spec.name].key != spec.key:
                other = f"{spec.name}_{spec.identifier:X}"
                words = f"{spec.name} has two identifiers; this one is called {other}"
                self._flaw("duplicate message", message.found.start(), words)
                spec = replace(spec, name=other)
            before = by_key.get(spec.key)
            if before is not None:
                specs.pop(before.name, None)
            specs[spec.name] = by_key[spec.key] = spec
        return Bus(
            name=name,
            messages=specs,
            by_key=by_key,
            nodes={self._long_nodes.get(node, node): told for node, told in self._nodes.items()},
            baudrate=_whole(self._attributes.get("Baudrate")) or DEFAULT_BAUDRATE,
            data_baudrate=_whole(self._attributes.get("BaudrateCANFD")),
            warnings=tuple(f"{name}: {each}" for each in self._damages.all()),
        )

    def _attribute(self, message: _Message, name: str) -> Any:
        """Return an attribute of a message, or its default, or None.

        An ENUM value is returned by its name.
        """
        if name in message.attributes:
            value, names = message.attributes[name], self._defined.get(name, ())
            if names and isinstance(value, int):
                return names[value] if 0 <= value < len(names) else None
            return value
        return self._defaults.get(name)

    def _frame_format(self, message: _Message) -> str:
        if "VFrameFormat" not in self._defined:
            return ""
        value = self._attribute(message, "VFrameFormat")
        if isinstance(value, int):
            return FRAME_FORMATS[value] if 0 <= value < len(FRAME_FORMATS) else ""
        return str(value or "")

    def _spec(self, message: _Message) -> MessageSpec:
        told = message.attributes
        name = str(told.get("SystemMessageLongSymbol") or message.found["name"])
        period_ms = _whole(self._attribute(message, "GenMsgCycleTime"))
        timeout = _whole(told.get("TimeoutMs") or told.get("E2ETimeout"))
        senders = [message.found["sender"] or NO_NODE, *message.more_senders]
        senders = [self._long_nodes.get(each, each) for each in dict.fromkeys(senders)]
        defaults = {each: self._defaults[each] for each in PROTECTION if self._defaults.get(each)}
        frame_format = self._frame_format(message)
        send_type = str(self._attribute(message, "GenMsgSendType") or "")
        return MessageSpec(
            name=name,
            key=message.key,
            length=self._length(message),
            senders=() if senders == [NO_NODE] else tuple(senders),
            period_ms=period_ms,
            timeout_ms=timeout or TIMEOUT_PERIODS * period_ms,
            is_fd=frame_format.endswith("CAN_FD"),
            comment=message.comment,
            signals=self._signals(message),
            attributes={**defaults, **{each: told[each] for each in PROTECTION if each in told}},
            optional="ifactive" in send_type.lower() or told.get("Optional") in (1, "yes"),
            is_j1939=frame_format == J1939_FORMAT,
        )

    def _length(self, message: _Message) -> int:
        try:
            return int(message.found["length"], 0)
        except ValueError:
            words = f"{message.found['name']}: {message.found['length']} is no length; taken as 8"
            self._flaw("unreadable length", message.found.start(), words)
            return 8

    def _signals(self, message: _Message) -> tuple[SignalSpec, ...]:
        """Sort the signals by first bit. Signals of one name in several pages become one."""
        selectors = [each for each in message.signals if each.mux.endswith("M")]
        root = next((each for each in selectors if each.mux == "M"), None)
        if root is None and len(selectors) == 1:
            root = selectors[0]
        specs: dict[str, SignalSpec] = {}
        long = {each.name: each.long_name or each.name for each in message.signals}
        for signal in message.signals:
            selector = self._selector(message, signal, root, len(selectors))
            spec = self._signal(message, signal, long[signal.name], selector, long)
            if spec is None:
                continue
            before = specs.get(spec.name)
            if before is None:
                specs[spec.name] = spec
            elif spec.multiplexer is not None and before.multiplexer == spec.multiplexer:
                specs[spec.name] = replace(before, others=(*before.others, spec))
            else:
                words = f"{message.found['name']}.{spec.name}: the one that begins last counts"
                self._flaw("duplicate signal", signal.found.start(), words)
                specs[spec.name] = max(before, spec, key=first_bit)
        return tuple(sorted(specs.values(), key=first_bit))

    def _selector(
        self, message: _Message, signal: _Signal, root: _Signal | None, count: int
    ) -> tuple[str, list[int]] | None:
        """Return what decides whether a signal is present: the selector's name and its values."""
        digits = signal.mux.strip("mM")
        own = [int(digits)] if digits else []
        if signal.selector is not None:
            if not message.named(signal.selector):
                words = f"{message.found['name']} has no signal {signal.selector}"
                self._flaw("stray SG_MUL_VAL_", signal.found.start(), words)
                return None
            return signal.selector, [*(own if count == 1 else []), *signal.pages]
        if not own:
            return None
        if root is None or root is signal:
            words = f"{message.found['name']}.{signal.name}: no signal chooses its page"
            self._flaw("page without a selector", signal.found.start(), words)
            return None
        return root.name, own

    def _signal(
        self,
        message: _Message,
        signal: _Signal,
        name: str,
        selector: tuple[str, list[int]] | None,
        long: Mapping[str, str],
    ) -> SignalSpec | None:
        found = signal.found
        start, length = int(found["start"]), int(found["length"])
        of = f"{message.found['name']}.{signal.name}"
        if not 0 < length <= SIGNAL_BITS_MAX or start >= SIGNAL_BITS_MAX:
            self._flaw("impossible signal", found.start(), f"{of}: {start}|{length}; left out")
            return None
        if signal.float_bits not in (0, length):
            words = f"{of}: no float of that kind has {length} bits; taken as an integer"
            self._flaw("impossible float", found.start(), words)
        low, high = found["low"], found["high"]
        bounded = low is not None and (_number(low) != 0 or _number(high) != 0)
        receivers = found["receivers"].replace(",", " ").split()
        receivers = [] if receivers == [NO_NODE] else receivers
        return SignalSpec(
            name=name,
            start=start,
            length=length,
            big_endian=found["order"] == "0",
            signed=found["sign"] == "-",
            is_float=signal.float_bits == length,
            scale=_number(found["scale"]),
            offset=_number(found["offset"]),
            minimum=_number(low) if bounded else None,
            maximum=_number(high) if bounded else None,
            unit=_plain(found["unit"] or ""),
            choices=signal.choices,
            comment=signal.comment,
            receivers=tuple(self._long_nodes.get(each, each) for each in receivers),
            is_multiplexer=signal.mux.endswith("M"),
            multiplexer=long[selector[0]] if selector else None,
            multiplexer_ids=tuple(dict.fromkeys(selector[1])) if selector else (),
        )


def first_bit(signal: SignalSpec) -> int:
    """First bit of a signal, counted so that Motorola signals sort by their bytes."""
    if signal.big_endian:
        return 8 * (signal.start // 8) + 7 - signal.start % 8
    return signal.start


def _plain(text: str) -> str:
    return text.replace('\\"', '"')


def _number(text: str) -> int | float:
    try:
        return int(text)
    except ValueError:
        return float(text)


def _value(text: str) -> Any:
    return _plain(text[1:-1]) if text.startswith('"') else _number(text)


def _whole(value: Any) -> int:
    """Return an attribute's value as an integer; 0 if it is not a number."""
    try:
        return int(float(value or 0))
    except (ValueError, OverflowError):
        return 0


def _pairs(text: str) -> dict[int, str]:
    return {int(float(number)): _plain(name) for number, name in PAIR.findall(text)}
