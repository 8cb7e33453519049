"""Packs bodies of train-to-train messages in msgpack directly from their fields, and checks their
plausibility.
"""

import dataclasses
import operator
import typing
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import msgspec

from zenoh_config.messages import MAX_ADDRESS, RESTRICTIONS_MAX, SpeedRestriction
from zenoh_config.soundness import MAX_CHAINAGE_M, MAX_NUMBER, MAX_SPEED_MPS, MAX_STAMP_NS
from zenoh_config.t2t import (
    ARBITERS_MAX,
    ROSTER_MAX,
    SECTIONS_MAX,
    TERM_MAX,
    AreaAuthority,
    SignedGrant,
    T2tMessage,
    TrainReport,
)
from zenoh_config.t2t_types import T2T_TYPES

FIRST_TYPE: Final = 16
AREA_MAX: Final = 255
AXLES_MAX: Final = 1000
LEASES_MAX: Final = 56
SILENT_MAX: Final = 64
"""Maximum numbers of leases and silent trains that fit into one message beside its other fields."""
SIGNATURE_BYTES: Final = 64
"""Greatest length of a signature. Ed25519 has 64 bytes."""
TYPE_NUMBERS: Final = {kind: FIRST_TYPE + at for at, kind in enumerate(T2T_TYPES)}
HEADER_FIELDS: Final = ("source", "destination", "sequence", "stamp_ns")
"""Fields of every message that are in the header of the envelope and not in the body."""
_LENGTHS: Final = {
    "roster": ROSTER_MAX,
    "entries": ROSTER_MAX,
    "sections": SECTIONS_MAX,
    "restrictions": RESTRICTIONS_MAX,
    "closed": RESTRICTIONS_MAX,
    "trains": ROSTER_MAX,
    "leases": LEASES_MAX,
    "silent": SILENT_MAX,
    "grants": ARBITERS_MAX,
}
_ADDRESSES: Final = (
    *("source", "destination", "successor", "holder", "standby", "train", "behind", "before"),
    "arbiter",
)
_MOST: Final = {
    **dict.fromkeys(_ADDRESSES, MAX_ADDRESS),
    "waits_for": MAX_ADDRESS,
    **dict.fromkeys(("term", "held_term", "claim_term", "roster_term", "granted_term"), TERM_MAX),
    "area": AREA_MAX,
    "comes_from": AREA_MAX,
    "axles": AXLES_MAX,
    "rank": ROSTER_MAX,
}
"""Greatest value of an integer field; other fields allow up to 2^32 - 1."""

_STRETCHES: Final = tuple[SpeedRestriction, ...]

Bounds = tuple[str, Any, Any]
"""Name of a field with its least and greatest value."""

_encode: Final = msgspec.msgpack.Encoder().encode


def body_fields(kind: type[T2tMessage]) -> tuple[str, ...]:
    """Names of the body's fields, in order."""
    return tuple([f.name for f in dataclasses.fields(kind) if f.name not in HEADER_FIELDS])


class _Layout:
    """How one kind of message is packed, opened and checked; computed once."""

    def __init__(self, kind: type[T2tMessage]) -> None:
        hints = typing.get_type_hints(kind)
        self.kind = kind
        body = body_fields(kind)
        types = tuple([_wire_type(hints[name]) for name in body])
        self.decoder = msgspec.msgpack.Decoder(tuple.__class_getitem__(types))
        self.body: Callable[[T2tMessage], tuple[Any, ...]] = operator.attrgetter(*body)
        self.restrictions = tuple([at for at, name in enumerate(body) if hints[name] == _STRETCHES])
        """Indices of restriction lists in the body."""
        numbers = [name for name in hints if typing.get_origin(hints[name]) is not tuple]
        self.numbers: Callable[[T2tMessage], tuple[Any, ...]] = operator.attrgetter(*numbers)
        self.bounds = tuple([_bounds(name) for name in numbers])
        self.lists = tuple(
            [_List(name, hints[name]) for name in hints if typing.get_origin(hints[name]) is tuple]
        )


class _List:
    """Maximum number of entries of a list field, and the ranges of the entries' fields."""

    def __init__(self, name: str, hint: Any) -> None:
        entry: Any = typing.get_args(hint)[0]
        self.name = name
        self.most = _LENGTHS[name]
        names = () if entry is SpeedRestriction else entry._fields
        # A signature is the last field of its entry. It has a length instead of a range.
        self.bounds = tuple([_bounds(each) for each in names if each != "signature"])


def _bounds(name: str) -> Bounds:
    """Return the range of a field. Booleans and enumerations count as small numbers."""
    if name.endswith(("_m", "_mps")):
        most_of_unit = MAX_SPEED_MPS if name.endswith("_mps") else MAX_CHAINAGE_M
        return name, -most_of_unit, most_of_unit
    return name, 0, MAX_STAMP_NS if name.endswith("_ns") else _MOST.get(name, MAX_NUMBER)


def _wire_type(hint: Any) -> Any:
    return tuple[_Restriction, ...] if hint == _STRETCHES else hint


class _Restriction(NamedTuple):
    start_m: float
    end_m: float
    limit_mps: float


def packed_body(message: T2tMessage) -> bytes:
    layout = _LAYOUTS[type(message)]
    values = layout.body(message)
    if not layout.restrictions:
        return _encode(values)
    plain = list(values)
    for at in layout.restrictions:
        plain[at] = [(each.start_m, each.end_m, each.limit_mps) for each in values[at]]
    return _encode(plain)


def opened(
    number: int, source: int, destination: int, sequence: int, stamp_ns: int, body: bytes
) -> T2tMessage:
    """Decode a message.

    Raises msgspec's errors for a body that is not of this type, KeyError for an unknown type.
    """
    layout = _BY_NUMBER[number]
    told: Any = layout.decoder.decode(body)
    if layout.restrictions:
        told = list(told)
        for at in layout.restrictions:
            told[at] = tuple([SpeedRestriction(*each) for each in told[at]])
    area, term, boot, *rest = told
    return layout.kind(source, destination, area, term, boot, sequence, stamp_ns, *rest)


def knows(number: int) -> bool:
    return number in _BY_NUMBER


def problem_of_t2t(message: T2tMessage) -> str:
    """Describe the first implausible field; empty without one."""
    layout = _LAYOUTS[type(message)]
    problem = _number_problem(layout.bounds, layout.numbers(message))
    if problem:
        return problem
    for each in layout.lists:
        problem = _list_problem(each, getattr(message, each.name))
        if problem:
            return problem
    if isinstance(message, TrainReport) and message.localised:
        return _order_problem(message)
    if isinstance(message, AreaAuthority) and not message.rear_m <= message.end_m:
        return f"rear_m {message.rear_m} is beyond end_m {message.end_m}"
    return ""


def _order_problem(report: TrainReport) -> str:
    if not report.rear_min_m <= report.front_min_m <= report.front_max_m <= report.latent_m:
        return (
            f"rear_min_m {report.rear_min_m}, front_min_m {report.front_min_m}, front_max_m "
            f"{report.front_max_m} and latent_m {report.latent_m} are not in this order"
        )
    if not report.rear_min_m <= report.protected_m <= report.front_max_m:
        return (
            f"protected_m {report.protected_m} is not between rear_min_m {report.rear_min_m} and "
            f"front_max_m {report.front_max_m}"
        )
    return ""


def _list_problem(known: _List, values: Any) -> str:
    if len(values) > known.most:
        return f"{len(values)} {known.name}, at most {known.most} fit"
    for each in values:
        if isinstance(each, SpeedRestriction):
            problem = _restriction_problem(each)
        else:
            problem = _number_problem(known.bounds, each)
        if not problem and isinstance(each, SignedGrant):
            length = len(each.signature)
            problem = "" if length <= SIGNATURE_BYTES else f"signature of {length} bytes"
        if problem:
            return f"{known.name}: {problem}"
    return ""


def _restriction_problem(each: SpeedRestriction) -> str:
    if not -MAX_CHAINAGE_M <= each.start_m <= each.end_m <= MAX_CHAINAGE_M:
        return f"from {each.start_m} m to {each.end_m} m is no stretch of a line"
    sound = 0.0 < each.limit_mps <= MAX_SPEED_MPS
    return "" if sound else f"limit {each.limit_mps} m/s is not in 0..{MAX_SPEED_MPS}"


def _number_problem(bounds: tuple[Bounds, ...], values: Any) -> str:
    """Check ranges; the comparisons also catch NaN."""
    for at, (name, least, most) in enumerate(bounds):
        value = values[at]
        if not least <= value <= most:
            span = f"±{most}" if least else f"0..{most}"
            return f"{name} {value} is not in {span}"
    return ""


_LAYOUTS: Final = {kind: _Layout(kind) for kind in T2T_TYPES}
_BY_NUMBER: Final = {number: _LAYOUTS[kind] for kind, number in TYPE_NUMBERS.items()}
