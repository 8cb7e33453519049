"""Generates and compiles, for one frame class, the functions between its fields and its payload
bits.

The DBC file gives the bit positions. Evaluating it for every frame takes ten times as long as plain
Python statements with fixed numbers, so these are generated once.
"""

import enum
import functools
import operator
from collections.abc import Callable
from typing import Any, Final

from can_dbc.agreement import FieldLayout
from can_dbc.binding import Binding, Frame, binding_of

Pack = Callable[[Any], int]
"""Converts a frame to payload bits; EncodeError for a value that the bits cannot represent."""
Unpack = Callable[[int], Frame | None]
"""Converts payload bits to a frame; None if a value is outside its range or table."""

TWO_BIT_TRUE: Final = 2
TWO_BIT_FALSE: Final = 1


class EncodeError(ValueError):
    """A field of a frame has an invalid value; the text names message, signal and value."""


@functools.cache
def packer(kind: type[Frame]) -> Pack:
    """Return the function from a frame of this class to its payload bits."""
    bound = binding_of(kind)
    lines = ["def pack(frame):", " try:"]
    names: dict[str, object] = {
        "refuse": functools.partial(refusal, kind),
        "bad": _bad,
        "index": operator.index,
    }
    for index, field in enumerate(bound.fields):
        names[f"kind{index}"] = field.kind
        lines += [f"  value = frame.{field.name}"]
        lines += ["  " + line for line in _pack_lines(field, index)]
    lines += ["  return bits"]
    lines += [" except (ValueError, TypeError, AttributeError):", "  raise refuse(frame) from None"]
    pack: Pack = _compiled(lines, names, kind)["pack"]
    return pack


@functools.cache
def unpacker(kind: type[Frame]) -> Unpack:
    """Return the function from payload bits to a frame of this class."""
    bound = binding_of(kind)
    names: dict[str, object] = {"kind": kind, "draft": _draft_of(bound)}
    lines = ["def unpack(bits):"]
    for index, field in enumerate(bound.fields):
        names[f"table{index}"] = value_table(field)
        lines += _unpack_lines(field, index)
    lines += [" frame = draft()"]
    lines += [f" frame.{field.name} = value{index}" for index, field in enumerate(bound.fields)]
    lines += [" frame.__class__ = kind", " return frame"]
    unpack: Unpack = _compiled(lines, names, kind)["unpack"]
    return unpack


def value_table(field: FieldLayout) -> tuple[enum.Enum | None, ...] | None:
    """Return the enumeration member of every raw value, None without one; None for other fields."""
    if not issubclass(field.kind, enum.Enum):
        return None
    return _members(field.kind, field.length)


@functools.cache
def _members(kind: type[enum.Enum], bits: int) -> tuple[enum.Enum | None, ...]:
    return tuple(_member(kind, raw) for raw in range(1 << bits))


def invalid_values(fields: tuple[FieldLayout, ...], bits: int) -> str:
    """Describe which raw values of a payload are outside their range or table."""
    found = []
    for field in fields:
        raw = _raw(field, bits)
        table = value_table(field)
        if table is not None and table[raw] is None:
            found.append(f"{field.name} is {raw}, which its value table does not have")
        elif field.kind in (int, float) and not field.raw_minimum <= raw <= field.raw_maximum:
            found.append(f"{field.name} is raw {raw}, outside its range")
    return "; ".join(found)


def _draft_of(bound: Binding) -> Callable[[], Any]:
    """Create a class with the slots of the frame class but without the freeze.

    A frozen dataclass sets its fields through object.__setattr__, which takes longer than the rest
    of decoding. A draft is filled by plain assignments and then becomes a frame by changing its
    class. From then on it is frozen like any other.
    """
    slots = tuple(field.name for field in bound.fields)
    return type(f"Draft{bound.kind.__name__}", (), {"__slots__": slots})


def _compiled(lines: list[str], names: dict[str, object], kind: type[Frame]) -> dict[str, Any]:
    source = "\n".join(lines) + "\n"
    code = compile(source, f"<packing of {kind.__name__}>", "exec")
    # The source consists only of numbers and field names of our own bound classes.
    exec(code, names)  # noqa: S102
    return names


def _pack_lines(field: FieldLayout, index: int) -> list[str]:
    add = "bits +=" if index else "bits ="
    if field.kind is bool:
        true, false = (hex(raw << field.start) for raw in bool_raws(field))
        return [f"{add} {true} if value is True else {false} if value is False else bad()"]
    if issubclass(field.kind, enum.Enum):
        return [
            f"if value.__class__ is not kind{index}: bad()",
            f"{add} value._value_{_shift('<<', field.start)}",
        ]
    mask = (1 << field.length) - 1
    least, most = ((raw & mask) << field.start for raw in (field.raw_minimum, field.raw_maximum))
    lines, raw = [], f"round({_unscaled(field)})"
    if field.kind is int:
        # Comparing the class is faster than the call that converts an int to an int.
        lines, raw = ["if value.__class__ is not int: value = index(value)"], _unscaled(field)
    if field.signed:
        raw = f"({raw} & {mask:#x})"
    return [
        *lines,
        f"{add} {least:#x} if value <= {field.minimum!r}"
        f" else {most:#x} if value >= {field.maximum!r}"
        f" else {raw}{_shift('<<', field.start)}",
    ]


def _unpack_lines(field: FieldLayout, index: int) -> list[str]:
    mask = (1 << field.length) - 1
    raw = f"bits{_shift('>>', field.start)} & {mask:#x}"
    if field.kind is bool:
        true, _ = bool_raws(field)
        return [f" value{index} = bits & {mask << field.start:#x} == {true << field.start:#x}"]
    if issubclass(field.kind, enum.Enum):
        return [f" value{index} = table{index}[{raw}]", f" if value{index} is None: return None"]
    if field.signed:
        sign = 1 << field.length - 1
        raw = f"({raw} ^ {sign:#x}) - {sign:#x}"
    lines = [f" raw = {raw}"]
    if field.raw_maximum - field.raw_minimum < mask:
        lines += [f" if not {field.raw_minimum} <= raw <= {field.raw_maximum}: return None"]
    return [*lines, f" value{index} = {_scaled(field)}"]


def _shift(operator: str, places: int) -> str:
    return f" {operator} {places}" if places else ""


def _unscaled(field: FieldLayout) -> str:
    """Use the same two operations as cantools, so that every value is rounded alike."""
    shifted = f"(value - {field.offset!r})" if field.offset else "value"
    return f"{shifted} / {field.scale!r}" if field.scale != 1 else shifted


def _scaled(field: FieldLayout) -> str:
    text = f"raw * {float(field.scale)!r}" if field.kind is float else "raw"
    return f"{text} + {field.offset!r}" if field.offset else text


def bool_raws(field: FieldLayout) -> tuple[int, int]:
    """Raw values of true and of false."""
    return (TWO_BIT_TRUE, TWO_BIT_FALSE) if field.length > 1 else (1, 0)


def _raw(field: FieldLayout, bits: int) -> int:
    raw = bits >> field.start & (1 << field.length) - 1
    return raw - (1 << field.length) if field.signed and raw >> field.length - 1 else raw


def _member(kind: type[enum.Enum], raw: int) -> enum.Enum | None:
    try:
        return kind(raw)
    except ValueError:
        return None


def _bad() -> int:
    raise ValueError


def refusal(kind: type[Frame], frame: Frame) -> EncodeError:
    """Return the error for the first field with an invalid value."""
    bound = binding_of(kind)
    where = bound.message.name
    for field in bound.fields:
        value = getattr(frame, field.name)
        if value != value:
            return EncodeError(f"{where}: {field.name}: {value!r} is not a number")
        wanted = (int, float) if field.kind is float else field.kind
        if not isinstance(value, wanted):
            return EncodeError(
                f"{where}: {field.name}: {value!r} is {type(value).__name__},"
                f" not {field.kind.__name__}"
            )
    return EncodeError(f"{where}: cannot be encoded: {frame!r}")
