"""Reads a log: whole, with its messages as tables, or block by block with bounded memory."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from canlog.bus_model import CHANNEL_SIGN, ORIGIN_SIGN, LogPart, part_names
from canlog.damage import Damage, Damages, LogError
from canlog.database import Bus, MessageSpec, load_bus
from canlog.formats.foreign import looks_like
from canlog.formats.registry import format_of
from canlog.formats.text import JUNK, TORN
from canlog.frames import Frames, Ints, concat
from canlog.options import ReadOptions
from canlog.plan import Column
from canlog.run import RunFiles, bus_log_of, read_run
from canlog.shelf import Room, in_memory, on_disk, shelved
from canlog.source import head_of
from canlog.table import Groups, Table, merged
from canlog.transport.tables import LongTables

Dbc = Path | str | Sequence[Path | str] | Bus | None


@dataclass(slots=True)
class _Found:
    """What the log has of one part."""

    spec: MessageSpec
    part: LogPart
    keys: list[int] = field(default_factory=list)
    """Keys of its frames."""
    long: list[Table] = field(default_factory=list)
    """Its reassembled messages."""


class Log:
    """A log in memory."""

    def __init__(
        self,
        path: Path,
        frames: Frames | Sequence[Frames],
        bus: Bus,
        warnings: tuple[Damage, ...] = (),
        run: RunFiles | None = None,
        room: Room = in_memory,
    ) -> None:
        """Keep the blocks of frames; they are joined when a caller needs all frames at once.

        Args:
            room: allocates the sorted columns.
        """
        self.room = room
        self.path = path
        self._blocks = (frames,) if isinstance(frames, Frames) else tuple(frames)
        self.bus = bus
        self.warnings = warnings
        """Damage, and what was uncertain."""
        self.run = run
        """Other files of a run folder; None for a log alone."""
        self._tables: dict[str, Table] = {}

    def __len__(self) -> int:
        return sum(len(block) for block in self._blocks)

    @cached_property
    def frames(self) -> Frames:
        """All frames as columns."""
        self._blocks = (concat(self._blocks),)
        return self._blocks[0]

    @cached_property
    def groups(self) -> Groups:
        return Groups(self._blocks, self.room)

    @property
    def start_ns(self) -> int:
        """The earliest stamp; 0 for a log without frames."""
        return min((int(each.at_ns.min()) for each in self._blocks if len(each)), default=0)

    @property
    def end_ns(self) -> int:
        """The latest stamp; 0 for a log without frames."""
        return max((int(each.at_ns.max()) for each in self._blocks if len(each)), default=0)

    @cached_property
    def _parts(self) -> dict[str, _Found]:
        """What the log has of each message on each channel from each source, by its name here."""
        found: dict[LogPart, _Found] = {}
        for key, channel in self.groups.places:
            spec = self.bus.on(channel).spec_at(key)
            if spec is not None:
                part = LogPart(spec.name, channel, spec.origin(key))
                found.setdefault(part, _Found(spec, part)).keys.append(key)
        long = LongTables(self.bus)
        tables = [item for block in self._blocks for item in long.feed(block).items()]
        for part, table in sorted(tables, key=lambda item: item[0]):
            found.setdefault(part, _Found(table.spec, part)).long.append(table)
        names = part_names(found)
        return {names[part]: one for part, one in found.items()}

    @cached_property
    def _names(self) -> dict[tuple[int, str], str]:
        """Name in this log by key and channel."""
        return {
            (key, one.part.channel): name for name, one in self._parts.items() for key in one.keys
        }

    @property
    def messages(self) -> Mapping[str, MessageSpec]:
        """Messages of which the log has data frames, by name, in order of keys.

        A message on several channels is listed once for each, as `can1:MESSAGE`; one of J1939 from
        several sources once for each, as `MESSAGE@03`, or `MESSAGE@03-0B` with a destination.
        """
        return {name: one.spec for name, one in self._parts.items()}

    def name_at(self, key: int, channel: str) -> str:
        """Return the name in this log of frames with a key on a channel."""
        known = self._names.get((key, channel))
        if known is not None:
            return known
        name = self.bus.on(channel).name_of(key)
        several = sum(key == each for each, _ in self.groups.places) > 1
        return f"{channel}{CHANNEL_SIGN}{name}" if several else name

    def asked_as(self, text: str, name: str) -> bool:
        """Whether a user may mean the message `name` of this log by a text."""
        one = self._parts.get(name)
        return one is not None and text in one.part.texts

    def part_of(self, name: str) -> LogPart:
        """Return the part of a message; without channel and origin if the log lacks the message."""
        one = self._parts.get(name)
        return one.part if one is not None else LogPart(name, "")

    def places_of(self, signal: str) -> list[tuple[int, str]]:
        """Return key and channel of the frames that carry `MESSAGE.signal`."""
        one = self._parts.get(signal.partition(".")[0])
        return [] if one is None else [(key, one.part.channel) for key in one.keys]

    @property
    def unknown(self) -> tuple[int, ...]:
        """Keys of data frames that no DBC file defines."""
        keys = (key for key, on in self.groups.places if self.bus.on(on).spec_at(key) is None)
        return tuple(dict.fromkeys(keys))

    def rows(self, key: int) -> Ints:
        """Return the rows of the frames with a key, rising."""
        return self.groups.rows(key)

    def _asked(self, name: str) -> list[_Found]:
        """Return what a name means in this log: one part, or all sources of a J1939 message.

        Raises:
            LogError: if several channels have the message.
        """
        one = self._parts.get(name)
        if one is not None:
            return [one]
        found = {each: one for each, one in self._parts.items() if name in one.part.texts}
        if len({one.part.channel for one in found.values()}) > 1:
            raise LogError(f"{name}: several channels have it; name one of {', '.join(found)}")
        return list(found.values())

    def spec(self, name: str) -> MessageSpec:
        """Return a message by its name in this log. Raises LogError."""
        found = self._asked(name)
        if found:
            return found[0].spec
        channel, sign, plain = name.rpartition(CHANNEL_SIGN)
        bus = self.bus.on(channel) if sign else self.bus
        return bus.message(plain.partition(ORIGIN_SIGN)[0])

    def table(self, name: str) -> Table:
        """Return all messages of a name, from all sources in J1939; none if the log lacks it.

        Raises:
            LogError: if no file defines the message, or several channels have it.
        """
        found = self._tables.get(name)
        if found is None:
            found = self._tables[name] = self.fresh_table(name)
        return found

    def fresh_table(self, name: str) -> Table:
        """Return a table like `table`, which the log does not keep in memory."""
        spec, found = self.spec(name), self._asked(name)
        if not found:
            return self.groups.table(spec, "", ())
        keys = [key for one in found for key in one.keys]
        single = [self.groups.table(spec, found[0].part.channel, keys)] if keys else []
        return merged([*single, *(table for one in found for table in one.long)])

    def signal(self, name: str) -> tuple[Ints, Column]:
        """Return instants and physical values of `MESSAGE.signal` where a frame carries it.

        Raises:
            LogError: for a name that is not `MESSAGE.signal` of the DBC file.
        """
        message, dot, signal = name.partition(".")
        if not dot:
            raise LogError(f"{name}: name a signal as MESSAGE.signal")
        table = self.table(message)
        valid = table.valid(signal)
        if valid.all():
            return table.at_ns, table[signal]
        return table.at_ns[valid], table[signal][valid]


class Stream:
    """A log read block by block. Iterate once; then `warnings` is complete."""

    def __init__(self, path: Path | str, options: ReadOptions | None = None) -> None:
        """Raises LogError for a file that cannot be opened or has no known format."""
        self.path = bus_log_of(Path(path))
        self._options = options or ReadOptions()
        self._format = format_of(self.path, self._options.format)
        self.damages = Damages()

    @property
    def format(self) -> str:
        return self._format.name

    @property
    def warnings(self) -> tuple[Damage, ...]:
        return self.damages.all()

    @property
    def skipped(self) -> dict[str, int]:
        """Counts of what the format contains besides CAN frames, such as statistics."""
        return self.damages.skipped

    def __iter__(self) -> Iterator[Frames]:
        """Raises LogError at the end of a file without frames, if the options refuse that."""
        held, wanted, seen = False, self._options.channels, dict[str, None]()
        for block in self._format.read(self.path, self._options, self.damages):
            seen |= dict.fromkeys(block.channels)
            chosen = _on_channels(block, wanted) if wanted else block
            held = held or len(chosen) > 0
            yield chosen
        if self._options.refuse_empty and not held:
            if wanted and seen:
                there = ", ".join(seen)
                raise LogError(f"--channel {' '.join(wanted)}: {self.path} has frames of {there}")
            raise LogError(self._without_frames())

    def _without_frames(self) -> str:
        found = f"{self.path}: holds no frame (read as {self.format})"
        if any(each.kind in (JUNK, TORN) for each in self.warnings):
            found += f"; it looks like {looks_like(head_of(self.path))}"
        if self.warnings:
            return f"{found}; {self.warnings[0]}; name a log of CAN frames, or its --format"
        return f"{found}; name a log of CAN frames"


def _on_channels(block: Frames, wanted: Sequence[str]) -> Frames:
    """Return the frames of these channels, with only these channel names."""
    kept = [name for name in block.channels if name in wanted]
    number = np.full(len(block.channels) or 1, len(kept), np.uint8)
    for at, name in enumerate(block.channels):
        number[at] = kept.index(name) if name in kept else len(kept)
    channel = number[block.channel]
    found = replace(block, channel=channel, channels=tuple(kept))
    return found[channel < len(kept)]


def stream(path: Path | str, options: ReadOptions | None = None) -> Stream:
    """Return the frames of a log of any size, block by block. Raises LogError."""
    return Stream(path, options)


def read(path: Path | str, dbc: Dbc = None, options: ReadOptions | None = None) -> Log:
    """Read a whole log, or that of a run folder, with the bus of `dbc` (default: this project's).

    Raises:
        LogError: names the file that cannot be read.
    """
    bus = load_bus(dbc)
    source = stream(path, options)
    far = options is not None and options.on_disk
    blocks: Sequence[Frames] = (shelved(source),) if far else list(source)
    run = None
    if Path(path).is_dir():
        blocks = (concat(blocks),)
        run = read_run(Path(path), blocks[0], bus, source.damages)
    return Log(source.path, blocks, bus, source.warnings, run, on_disk if far else in_memory)
