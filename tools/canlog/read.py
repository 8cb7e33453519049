"""Reads a log: as a whole with its messages as tables, or block by block with bounded memory."""

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path

from canlog.damage import Damage, Damages, LogError
from canlog.database import Bus, MessageSpec, load_bus
from canlog.formats.registry import format_of
from canlog.frames import Frames, Ints, concat
from canlog.options import ReadOptions
from canlog.plan import Column
from canlog.run import RunFiles, bus_log_of, read_run
from canlog.shelf import Room, in_memory, on_disk, shelved
from canlog.table import Groups, Table

Dbc = Path | str | Sequence[Path | str] | Bus | None


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
        """Blocks of frames are put together when somebody asks for them as a whole.

        `room` gives what is sorted its place.
        """
        self.room = room
        self.path = path
        self._blocks = (frames,) if isinstance(frames, Frames) else tuple(frames)
        self.bus = bus
        self.warnings = warnings
        """What was damaged or could not be told for certain."""
        self.run = run
        """What else a run folder holds; None for a log by itself."""
        self._tables: dict[str, Table] = {}

    def __len__(self) -> int:
        return sum(len(block) for block in self._blocks)

    @cached_property
    def frames(self) -> Frames:
        """All of them as columns."""
        self._blocks = (concat(self._blocks),)
        return self._blocks[0]

    @cached_property
    def groups(self) -> Groups:
        return Groups(self._blocks, self.room)

    @property
    def start_ns(self) -> int:
        """The earliest stamp; 0 of a log without frames."""
        return min((int(each.at_ns.min()) for each in self._blocks if len(each)), default=0)

    @property
    def end_ns(self) -> int:
        """The latest stamp."""
        return max((int(each.at_ns.max()) for each in self._blocks if len(each)), default=0)

    @property
    def messages(self) -> Mapping[str, MessageSpec]:
        """Messages of the DBC file that the log has data frames of, by name, in order of keys."""
        by_key = self.bus.by_key
        return {by_key[key].name: by_key[key] for key in self.groups.keys if key in by_key}

    @property
    def unknown(self) -> tuple[int, ...]:
        """Keys of data frames that the DBC file does not know."""
        return tuple(key for key in self.groups.keys if key not in self.bus.by_key)

    def rows(self, key: int) -> Ints:
        """Which frames have a key, rising."""
        return self.groups.rows(key)

    def table(self, name: str) -> Table:
        """All data frames of a message; one of no rows for a message that the log lacks.

        Raises:
            LogError: when the DBC file does not know the message.
        """
        found = self._tables.get(name)
        if found is None:
            found = self._tables[name] = self.groups.table(self.bus.message(name))
        return found

    def signal(self, name: str) -> tuple[Ints, Column]:
        """Instants and physical values of `MESSAGE.signal`, where a frame carries it.

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
    """A log block by block. Iterate once; `warnings` is complete when that has ended."""

    def __init__(self, path: Path | str, options: ReadOptions | None = None) -> None:
        """Raises LogError for what cannot be opened or is of no known format."""
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

    def __iter__(self) -> Iterator[Frames]:
        """Raises LogError at the end of a file without a frame, if the options refuse that."""
        held = False
        for block in self._format.read(self.path, self._options, self.damages):
            held = held or len(block) > 0
            yield block
        if self._options.refuse_empty and not held:
            raise LogError(self._without_frames())

    def _without_frames(self) -> str:
        found = f"{self.path}: holds no frame (read as {self.format})"
        if self.warnings:
            return f"{found}; {self.warnings[0]}; name a log of CAN frames, or its --format"
        return f"{found}; name a log of CAN frames"


def stream(path: Path | str, options: ReadOptions | None = None) -> Stream:
    """The frames of a log of any size, a block at a time. Raises LogError."""
    return Stream(path, options)


def read(path: Path | str, dbc: Dbc = None, options: ReadOptions | None = None) -> Log:
    """A whole log, or that of a run folder, with the bus of `dbc` (default: this project's).

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
