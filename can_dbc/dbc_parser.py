"""Parses DBC files with cantools, whose import takes longer than the rest of this package."""

from collections.abc import Mapping
from typing import NamedTuple

import cantools.database
from cantools.database.can import Message as ParsedMessage
from cantools.database.can import Signal as ParsedSignal

from can_dbc.messages import DbcSignal, Message


class ParseError(Exception):
    """The text is no usable DBC file."""


class ParsedFile(NamedTuple):
    """The messages of a file in its order, and the comment of each node by name."""

    messages: list[Message]
    nodes: Mapping[str, str]


def parsed(text: str) -> ParsedFile:
    """Parse the content of a DBC file. Raises ParseError."""
    database = cantools.database.Database(strict=True)
    try:
        database.add_dbc_string(text)
    except Exception as error:
        # The parser's errors share no base class; all of them concern this text.
        raise ParseError(str(error)) from error
    return ParsedFile(
        messages=[_message(each) for each in database.messages],
        nodes={node.name: node.comment or "" for node in database.nodes},
    )


def _message(found: ParsedMessage) -> Message:
    assert found.dbc is not None
    return Message(
        name=found.name,
        frame_id=found.frame_id,
        is_extended_frame=found.is_extended_frame,
        length=found.length,
        senders=[*found.senders],
        send_type=found.send_type,
        cycle_time=found.cycle_time,
        comment=found.comment,
        attributes={name: each.value for name, each in found.dbc.attributes.items()},
        signals=[_signal(each) for each in found.signals],
    )


def _signal(found: ParsedSignal) -> DbcSignal:
    choices = {int(raw): str(name) for raw, name in (found.choices or {}).items()}
    return DbcSignal(
        name=found.name,
        start=found.start,
        length=found.length,
        byte_order=found.byte_order,
        is_signed=found.is_signed,
        is_float=found.is_float,
        is_multiplexer=found.is_multiplexer,
        multiplexer_ids=found.multiplexer_ids,
        scale=found.scale,
        offset=found.offset,
        minimum=found.minimum,
        maximum=found.maximum,
        unit=found.unit,
        choices=choices or None,
        raw_initial=found.raw_initial,
        receivers=[*found.receivers],
        comment=found.comment,
    )
