"""MCAP for Foxglove: raw frames on `/can/CHANNEL`, each decoded message on its own topic."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from canlog.damage import Damages, LogError
from canlog.database import Bus, MessageSpec, load_bus
from canlog.frames import ERROR, EXTENDED, FD_BYTES, Frames
from canlog.options import ReadOptions
from canlog.rows import Rows
from canlog.table import Groups, Table
from canlog.writing import lost

SCHEMA: Final = "canlog.Frame"
FRAME: Final = {
    "type": "object",
    "properties": {
        "at_ns": {"type": "string"},
        "id": {"type": "integer"},
        "flags": {"type": "integer"},
        "length": {"type": "integer"},
        "data": {"type": "string"},
    },
}


def _library() -> Any:
    try:
        import mcap.reader
        import mcap.writer
    except ImportError:
        raise LogError("MCAP needs mcap: pip install 'metro-vobc-bench[logs]'") from None
    return mcap


def write(path: Path, blocks: Iterable[Frames], losses: Damages, bus: Bus | None = None) -> None:
    """Write all frames, and their signals as JSON with physical values for plotting tools."""
    module = _library()
    bus = bus or load_bus()
    with path.open("wb") as raw:
        out = module.writer.Writer(raw)
        out.start(profile="", library="canlog")
        topics = _Topics(out)
        done = 0
        for frames in blocks:
            early = frames.at_ns < 0
            lost(losses, early, "stamp", "before 1970; log_time is 1970", done)
            _write_block(frames, bus, topics)
            done += len(frames)
        out.finish()


class _Topics:
    """Registers each topic at its first message."""

    def __init__(self, out: Any) -> None:
        self._out = out
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def put(self, topic: str, schema: str, told: dict[str, Any], at_ns: int, row: int) -> None:
        number = self._channels.get(topic)
        if number is None:
            if schema not in self._schemas:
                text = json.dumps(told).encode()
                self._schemas[schema] = self._out.register_schema(schema, "jsonschema", text)
            number = self._channels[topic] = self._out.register_channel(
                topic, "json", self._schemas[schema]
            )
        self._number, self._at_ns, self._row = number, max(at_ns, 0), row

    def message(self, content: dict[str, Any]) -> None:
        text = json.dumps(content, allow_nan=False).encode()
        self._out.add_message(self._number, self._at_ns, text, self._at_ns, self._row & 0xFFFF_FFFF)


def _write_block(frames: Frames, bus: Bus, topics: _Topics) -> None:
    groups = Groups(frames)
    decoded: list[tuple[MessageSpec, dict[str, Any]] | None] = [None] * len(frames)
    for key, on in groups.places:
        spec = bus.on(on).spec_at(key)
        if spec is not None:
            table = groups.table(spec, on, (key,))
            for row, content in zip(table.rows.tolist(), _contents(table), strict=True):
                decoded[row] = spec, content
    for row in range(len(frames)):
        at_ns = int(frames.at_ns[row])
        channel = frames.channels[int(frames.channel[row])]
        topics.put(f"/can/{channel}", SCHEMA, FRAME, at_ns, row)
        topics.message(
            {
                "at_ns": str(at_ns),
                "id": int(frames.identifier[row]),
                "flags": int(frames.flags[row]),
                "length": int(frames.length[row]),
                "data": frames.payload(row).hex(),
            }
        )
        told = decoded[row]
        if told is not None:
            topics.put(f"/{channel}/{told[0].name}", told[0].name, _schema(told[0]), at_ns, row)
            topics.message(told[1])


def _schema(spec: MessageSpec) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": {
            signal.name: {"type": "number", "description": signal.unit} for signal in spec.signals
        },
    }


def _contents(table: Table) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = [{} for _ in range(len(table))]
    for name in table.names:
        valid = table.valid(name) & np.isfinite(table[name].astype(np.float64))
        rows = zip(found, table[name].tolist(), valid.tolist(), strict=True)
        for content, value, there in rows:
            if there:
                content[name] = value
    return found


def read(path: Path, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    """Yield the raw frames of a file that `write` has written, in its order.

    Raises:
        LogError: for a file that cannot be read.
    """
    module = _library()
    rows, foreign = Rows(), 0
    try:
        with path.open("rb") as raw:
            reader = module.reader.NonSeekingReader(raw)
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                if schema is None or schema.name != SCHEMA:
                    foreign += not channel.topic.startswith("/")
                    continue
                if not _take(channel.topic.removeprefix("/can/"), message.data, rows):
                    damages.add("junk message", "frame", len(rows) + 1, repr(message.data[:60]))
                if len(rows) >= options.block_frames:
                    yield rows.take()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:
        # The library raises any error of its parsing; the frames before it are complete.
        damages.add("torn file", "frame", len(rows) + 1, repr(error))
    if len(rows):
        yield rows.take()


def _take(channel: str, content: bytes, rows: Rows) -> bool:
    try:
        told = json.loads(content)
        data = bytes.fromhex(told["data"])
        identifier, flags, length = told["id"], told["flags"], told["length"]
        numbers = (identifier, flags, length)
        if not all(type(each) is int for each in numbers) or len(data) > FD_BYTES:
            return False
        limit = 1 << 29 if flags & (EXTENDED | ERROR) else 1 << 11
        if not (0 <= identifier < limit and 0 <= flags < 128 and 0 <= length <= FD_BYTES):
            return False
        return rows.add(int(told["at_ns"]), identifier, flags, channel, length, data)
    except (ValueError, KeyError, TypeError):
        return False
