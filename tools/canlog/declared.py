"""Checks alive counters and CRCs that a DBC file declares by attributes, for whole columns of
frames.

Message attributes: `E2ECounterSignal` and `E2ECrcSignal` name the signals, `E2EProfile` names the
profile, `E2EDataId` is the data identifier that the CRC covers before the data.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from canlog.database import MessageSpec, SignalSpec
from canlog.frames import Ints
from canlog.plan import DecodingPlan, Payloads

COUNTER, CRC, PROFILE, DATA_ID = "E2ECounterSignal", "E2ECrcSignal", "E2EProfile", "E2EDataId"
P01_COUNTS: Final = 15
"""AUTOSAR E2E profile 1: the counter runs from 0 to 14, and 15 is invalid."""
P01_NAMES: Final = ("P01", "AUTOSAR_P01", "PROFILE_01", "PROFILE01", "E2E_P01")
_POLYNOMIAL: Final = 0x1D


def _crc_table() -> Any:
    value: Any = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        value = value << 1 ^ np.where(value & 0x80, _POLYNOMIAL, 0).astype(np.uint16)
        value &= 0xFF
    return value.astype(np.uint8)


_CRC_8: Final = _crc_table()


@dataclass(frozen=True, slots=True)
class Declared:
    """The declared checks of one message, and why the others are impossible."""

    counter: SignalSpec | None = None
    counts: int = 0
    """Number of counter values; after the last one the counter continues at 0."""
    crc: SignalSpec | None = None
    data_id: int = 0
    why_no_counter: str = ""
    why_no_crc: str = ""


def declared_of(spec: MessageSpec) -> Declared:
    """Return the checks that the attributes of a message declare."""
    told = spec.attributes
    counter, no_counter = _signal(spec, COUNTER)
    crc, no_crc = _signal(spec, CRC)
    profile = str(told.get(PROFILE, "") or "")
    is_p01 = profile.upper() in P01_NAMES
    if crc is not None and not is_p01:
        no_crc = f"{PROFILE} {profile!r} is not known; P01 is" if profile else f"no {PROFILE}"
    elif crc is not None and DATA_ID not in told:
        no_crc = f"no {DATA_ID}"
    elif crc is not None and (crc.length != 8 or _first_bit(crc) % 8):
        no_crc = f"{crc.name} is no whole byte, as P01 wants it"
    counts = 0
    if counter is not None:
        counts = P01_COUNTS if is_p01 and counter.length == 4 else 1 << counter.length
    return Declared(
        counter,
        counts,
        None if no_crc else crc,
        0 if no_crc else int(told[DATA_ID]),
        no_counter,
        no_crc,
    )


def _signal(spec: MessageSpec, attribute: str) -> tuple[SignalSpec | None, str]:
    name = str(spec.attributes.get(attribute, "") or "")
    if not name:
        return None, f"no {attribute}"
    found = next((each for each in spec.signals if each.name == name), None)
    if found is None:
        return None, f"{attribute} names {name}, which the message does not have"
    if found.is_float or found.multiplexer is not None:
        return None, f"{attribute} names {name}, which is a float or not in every frame"
    return found, ""


def _first_bit(spec: SignalSpec) -> int:
    """Lowest bit of a byte-sized signal, counted from the low end."""
    return spec.start - 7 if spec.big_endian else spec.start


def p01_crc(payloads: Payloads, length: int, crc_byte: int, data_id: int) -> Any:
    """(n,): CRC of AUTOSAR E2E profile 1 with both bytes of the data identifier.

    It is a CRC-8 with polynomial 0x1D and start value 0 over the identifier, low byte first, and
    the data without the CRC byte (PRS_E2EProtocol, profile 1).
    """
    start = int(_CRC_8[_CRC_8[data_id & 0xFF] ^ (data_id >> 8 & 0xFF)])
    crc = np.full(len(payloads), start, np.uint8)
    for at in range(length):
        if at != crc_byte:
            crc = _CRC_8[crc ^ payloads.data[:, at]]
    return crc


class Follower:
    """Checks the frames of one message on one channel, block by block."""

    def __init__(self, spec: MessageSpec, plan: DecodingPlan) -> None:
        self.declared = declared_of(spec)
        self._spec, self._plan = spec, plan
        self._last: tuple[int, int] | None = None
        """Last value of the counter, and when it was received."""
        self.crc_errors = self.counter_errors = self.lost = 0

    @property
    def why_not(self) -> Mapping[str, str]:
        """The checks that are impossible, and why."""
        told = {"counter": self.declared.why_no_counter, "CRC": self.declared.why_no_crc}
        return {what: why for what, why in told.items() if why}

    def feed(self, payloads: Payloads, at_ns: Ints) -> None:
        """Check the next frames. Frames that are too short are left out."""
        good = payloads.length >= self._spec.length
        crc = self.declared.crc
        if crc is not None:
            wanted = p01_crc(
                payloads, self._spec.length, _first_bit(crc) // 8, self.declared.data_id
            )
            right = self._plan.raw(crc.name, payloads) == wanted
            self.crc_errors += int((good & ~right).sum())
            good &= right
        counter = self.declared.counter
        if counter is not None and good.any():
            raw = self._plan.raw(counter.name, payloads)[good].astype(np.int64)
            self._count(raw, at_ns[good])

    def _count(self, raw: Any, at_ns: Ints) -> None:
        """Count errors: a repeated value, a step backwards, or an invalid value."""
        counts = self.declared.counts
        none = raw >= counts
        self.counter_errors += int(none.sum())
        raw, at_ns = raw[~none], at_ns[~none]
        if not len(raw):
            return
        if self._last is not None:
            raw, at_ns = np.insert(raw, 0, self._last[0]), np.insert(at_ns, 0, self._last[1])
        self._last = int(raw[-1]), int(at_ns[-1])
        step = np.diff(raw) % counts
        if self._spec.timeout_ms:
            # After a timeout the number of counter wraps is unknown.
            step = step[np.diff(at_ns) <= self._spec.timeout_ms * 1_000_000]
        wrong = (step == 0) | (step > counts // 2)
        self.counter_errors += int(wrong.sum())
        self.lost += int((step[~wrong] - 1).sum())
