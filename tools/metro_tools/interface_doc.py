"""Writes docs/reference/can_interface.md from the DBC files, or checks that it is current."""

import itertools
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from can_dbc import binding, dbc_file
from can_dbc.binding import Binding, MessageProtection
from can_dbc.brake import BrakeCommand
from can_dbc.codec import TWIN_WITHIN_NS, Encoder
from can_dbc.dbc_file import DbcSignal, Message
from can_dbc.nodes import Node
from can_dbc.trailer import CRC_START, MAX_STEP
from metro_tools.generated_doc import markdown_table, write_or_check

DEFAULT_PATH: Final = "docs/reference/can_interface.md"
BIT_RATE_BPS: Final = 250_000
FRAME_BITS: Final = 47
"""Bits of a frame with 11-bit identifier and no data, including the interframe space, without
stuffing."""
STUFFED_BITS: Final = 34
"""Number of these bits that can be stuffed; data bits are additional."""

HEADER: Final = """\
# CAN interface of the train bus

Generated from the DBC files in `can_dbc/` by `python -m metro_tools.interface_doc`; change those
and generate it again. For a tool that accepts a single file, such as `cantools monitor` and
`cantools decode`, `python -m can_dbc.merged > train.dbc` merges them. The telegrams of the tag
reader have their own line: [serial interface](serial_interface.md).
"""

PROTECTION: Final = """\
## Protection

**NONE.** Payload only.

**SAFETY.** The last three bytes are a trailer:

| byte | content |
|---|---|
| n − 3 | `alive_counter`: one more with every transmission, modulo 256 |
| n − 2 | `crc16`, low byte |
| n − 1 | `crc16`, high byte |

The CRC has the polynomial 0x1021, starts at {crc_start:#06x}, is not reflected and not inverted
at the end. It covers the data id of the message (low byte, high byte), then the payload, then the
alive counter. The data id is not sent: a frame under a wrong identifier fails its CRC. Every
combination of up to three wrong bits is detected.

A receiver checks the alive counter of a frame with a valid CRC by its step from the last accepted
frame:

| step | verdict |
|---|---|
| first frame, or a silence longer than the timeout | accepted, whatever the counter |
| 1 | accepted |
| 2 to {max_step} | accepted; the frames between are counted as lost |
| 0 | rejected as stuck; while frames keep coming, the timeout never makes it accepted |
| anything else | rejected as jumped |

A stream of frames that jumped is accepted only after the accepted stream, stuck frames included,
has been silent for longer than the timeout, and only from a frame on that has step 1 from the
rejected one before it. So repeated frames are rejected while the true sender still sends. Eight
bits cannot tell a frame from one that is 256 transmissions older; only the timeout can.

A protected boolean takes two bits: `10` is true, `01` is what a sender sends for false, and a
receiver takes everything but `10` as false. A permissive signal is named so that true permits.

**VITAL.** SAFETY, and each transmission is a pair: the message, then within
{twin_ms:g} ms its twin `NAME_INV` on the next identifier, with every payload bit inverted, the
same alive counter and a CRC over its own data id. A receiver uses only a complete and matching
pair; half a pair has no effect. The DBC scales the twin's signals backwards, so that a
tool shows the same values for both.

**Everywhere.** A receiver rejects a frame of the wrong length, a number outside the range of its
signal and a value that a value table lacks. A sender sends the end of the range for a number
beyond it. A message not received for its timeout counts as absent, and every receiver then
assumes the restrictive state. Unused bits are sent as 0 and ignored.

Example: {example}
"""


def document() -> str:
    """Return the whole interface document."""
    bound = [binding.binding_of(kind) for kind in binding.kinds()]
    parts = [
        HEADER,
        _bus(bound),
        _nodes(bound),
        PROTECTION.format(
            crc_start=CRC_START,
            max_step=MAX_STEP,
            twin_ms=TWIN_WITHIN_NS / 1e6,
            example=_example(),
        ),
        _overview(bound),
    ]
    for name in dbc_file.names():
        parts += [f"## {name}\n", *_sections([each for each in bound if each.file.name == name])]
    return "\n".join(parts)


def _bus(bound: Sequence[Binding]) -> str:
    cyclic = [each for each in bound if each.period_s > 0.0]
    rate = sum(len(each.messages) / each.period_s for each in cyclic)
    least, most = (
        sum(len(each.messages) * bits(each.message.length) / each.period_s for each in cyclic)
        for bits in (plain_bits, stuffed_bits)
    )
    return (
        "## Bus\n\n"
        f"Classic CAN at {BIT_RATE_BPS // 1000} kbit/s, identifiers of 11 bits,"
        " Intel byte order (bit 0 is the least significant bit of byte 0).\n"
        f"Cyclic traffic is {rate:.0f} frames/s, {100 * least / BIT_RATE_BPS:.0f} % of the bus"
        f" without stuff bits and {100 * most / BIT_RATE_BPS:.0f} % at worst with them.\n"
    )


def plain_bits(length: int) -> int:
    """Return the bit times of a frame with `length` data bytes and the gap behind it, without stuff
    bits.
    """
    return FRAME_BITS + 8 * length


def stuffed_bits(length: int) -> int:
    """Return the same with the maximum number of stuff bits."""
    return plain_bits(length) + (STUFFED_BITS + 8 * length - 1) // 4


def _nodes(bound: Sequence[Binding]) -> str:
    comments = dbc_file.shipped("diagnostics.dbc").nodes
    rows = [
        (
            str(node.value),
            node.name,
            comments[node.name],
            _joined(each.message.name for each in bound if each.message.senders == [node.name]),
        )
        for node in Node
    ]
    return "## Nodes\n\n" + markdown_table(("number", "name", "description", "sends"), rows)


def _example() -> str:
    """Return the first pair of a full service brake application, in the format of candump."""
    command = BrakeCommand(service_decel_mps2=1.0, emergency_released=True, holding_released=True)
    first, second = Encoder().encode(command)
    message, twin = binding.binding_of(BrakeCommand).messages
    return (
        f"a service brake demand of {command.service_decel_mps2:g} m/s² with both releases given"
        f" is, as the first transmission,\n`{_candump(first)}` and `{_candump(second)}`;"
        f" data ids {_data_id(message)} and {_data_id(twin)}."
    )


def _candump(sent: tuple[int, bytes]) -> str:
    return f"{sent[0]:03X}#{sent[1].hex().upper()}"


def _overview(bound: Sequence[Binding]) -> str:
    rows = [
        (
            f"{message.frame_id:#05x}",
            message.name,
            message.senders[0],
            *_timing(each),
            str(message.length),
            each.protection.name,
            _data_id(message),
            f"`{each.file.name}`",
        )
        for each in bound
        for message in each.messages
    ]
    heads = ("id", "message", "sender", "period", "timeout", "bytes", "protection", "data id")
    return "## Messages\n\n" + markdown_table((*heads, "file"), rows)


def _timing(bound: Binding) -> tuple[str, str]:
    if math.isinf(bound.timeout_s):
        return "on occasion", "none"
    return f"{1000 * bound.period_s:.0f} ms", f"{1000 * bound.timeout_s:.0f} ms"


def _data_id(message: Message) -> str:
    number = dbc_file.data_id(message)
    return f"{number:#06x}" if number else "–"


def _sections(bound: Sequence[Binding]) -> Iterator[str]:
    """Yield one section for each message; neighbours with the same signals share one."""
    for signals, group in itertools.groupby(bound, key=_signals):
        same = list(group)
        yield f"### {_joined(each.message.name for each in same)}\n"
        yield "\n".join(f"- {_facts(each)}" for each in same) + "\n"
        yield signals


def _facts(bound: Binding) -> str:
    message = bound.message
    period, timeout = _timing(bound)
    facts = [
        f"{message.frame_id:#05x}, {message.senders[0]} to {_receivers(message)}, {_size(message)},"
        f" {period if math.isinf(bound.timeout_s) else f'every {period}, timeout {timeout}'}"
    ]
    if bound.protection is not MessageProtection.NONE:
        facts.append(f"{bound.protection.name}, data id {_data_id(message)}")
    if bound.twin is not None:
        twin = bound.twin
        facts.append(f"twin {twin.name} {twin.frame_id:#05x}, data id {_data_id(twin)}")
    return "; ".join(facts) + f". {message.comment}"


def _size(message: Message) -> str:
    return "1 byte" if message.length == 1 else f"{message.length} bytes"


def _receivers(message: Message) -> str:
    receivers = {name for signal in message.signals for name in signal.receivers}
    return _joined(node.name for node in Node if node.name in receivers)


def _signals(bound: Binding) -> str:
    rows = [
        (
            f"`{signal.name}`",
            _bits(signal),
            _scaling(signal),
            f"{_number(signal.minimum)} … {_number(signal.maximum)}",
            signal.unit or "",
            _values(signal),
            signal.comment or "",
        )
        for signal in bound.message.signals
    ]
    heads = ("signal", "bits", "value", "range", "unit", "value table", "meaning")
    return markdown_table(heads, rows)


def _bits(signal: DbcSignal) -> str:
    last = signal.start + signal.length - 1
    place = str(signal.start) if signal.length == 1 else f"{signal.start}–{last}"
    return f"{place} signed" if signal.is_signed else place


def _scaling(signal: DbcSignal) -> str:
    text = "raw" if signal.scale == 1 else f"raw × {_number(signal.scale)}"
    if not signal.offset:
        return text
    return f"{text} {'+' if signal.offset > 0 else '−'} {_number(abs(signal.offset))}"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.15g}".replace("-", "−")


def _values(signal: DbcSignal) -> str:
    return ", ".join(f"{raw} {name}" for raw, name in sorted(dbc_file.table_of(signal).items()))


def _joined(words: Iterable[str]) -> str:
    return ", ".join(words)


def main(argv: Sequence[str] | None = None) -> int:
    """Write the document, or with --check only report whether it is current."""
    return write_or_check(
        argv,
        module="metro_tools.interface_doc",
        description=__doc__,
        default_path=DEFAULT_PATH,
        document=document,
    )


if __name__ == "__main__":
    sys.exit(main())
