"""The package's DBC files as parsed beforehand, so that programs start without the parser.

After a change of a DBC file, `python -m metro_tools.parsed_dbc` writes `parsed.json`. Until then
programs parse that file at each start.
"""

import functools
import hashlib
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import Any, Final

from can_dbc.messages import DbcSignal, Message

NAME: Final = "parsed.json"


def find(name: str, text: str) -> tuple[list[Message], Mapping[str, str]] | None:
    """Return messages and nodes of a file; None if its content has changed since."""
    known = _everything().get(name)
    if known is None or known["sha256"] != _sha256(text):
        return None
    return [_message(row) for row in known["messages"]], known["nodes"]


def row(name: str, text: str, messages: Sequence[Message], nodes: Mapping[str, str]) -> str:
    """Format one file for `parsed.json`, with a line for each message."""
    lines = ",\n".join(json.dumps(_values(each)) for each in messages)
    head = f'{json.dumps(name)}: {{"sha256": "{_sha256(text)}", "nodes": {json.dumps(nodes)}'
    return f'{head}, "messages": [\n{lines}\n]}}'


def _values(message: Message) -> list[object]:
    signals = [
        each._replace(choices=each.choices and [*each.choices.items()])  # type: ignore[arg-type]
        for each in message.signals
    ]
    return [*message._replace(signals=signals)]


def _message(values: Sequence[Any]) -> Message:
    return Message._make([*values[:-1], [_signal(each) for each in values[-1]]])


def _signal(values: Sequence[Any]) -> DbcSignal:
    found = DbcSignal._make(values)
    # The keys of JSON objects are text, so the file has pairs.
    return found._replace(choices=dict(found.choices)) if found.choices else found


@functools.cache
def _everything() -> Mapping[str, Any]:
    text = (resources.files("can_dbc") / NAME).read_text(encoding="ascii")
    found: Mapping[str, Any] = json.loads(text)
    return found


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
