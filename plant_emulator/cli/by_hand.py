"""Files through which a person acts on a running train, and the records of what they did."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from can_dbc.cab import CabMode
from firmware_py.storage.growing_file import GrowingFile
from plant_emulator.cli.names import DESK, FAULTS
from plant_emulator.desk.attendant import Attendant
from plant_emulator.desk.by_keys import keyed
from plant_emulator.desk.recording import HEADER
from plant_emulator.faults.by_hand import FaultsByHand, record_text
from plant_emulator.faults.fitting import FaultTargets
from plant_emulator.faults.kinds import FaultPlace

DESK_KEYS: Final = "desk.keys"
"""Keys of the desk as they were pressed, one name a line."""
DESK_RECORDING: Final = "run.desk"
"""Recording of the desk, for --desk-recording."""
FAULT_ACTS: Final = "fault.acts"
"""Acts on faults as they were asked for, one a line; see `plant_emulator.faults.by_hand`."""
FAULT_RECORD: Final = "faults.toml"
"""The faults that began, as `[[fault]]` tables of a scenario."""


@dataclass(frozen=True, slots=True)
class TrainByHand:
    """What a person does to a running train, as the plant takes it."""

    desk: Attendant | None = None
    faults: FaultsByHand | None = None

    @property
    def fault_places(self) -> frozenset[FaultPlace]:
        """Places where a fault may act."""
        return frozenset() if self.faults is None else self.faults.places


def open_by_hand(
    folder: Path,
    allowed: tuple[str, ...],
    stack: ExitStack,
    *,
    mode: CabMode,
    start_ns: int,
    targets: FaultTargets,
    places: frozenset[FaultPlace],
) -> TrainByHand:
    """Open the files of a folder; the stack closes them. Raises OSError.

    Args:
        allowed: members of BY_HAND.
        mode: mode of the desk before the first key.
        places: places where this bench applies faults.
    """
    desk, faults = None, None
    if DESK in allowed:
        keys = _growing(folder / DESK_KEYS, stack)
        record = stack.enter_context((folder / DESK_RECORDING).open("x", buffering=1))
        record.write(HEADER)
        desk = keyed(keys.lines, record.write, mode=mode, start_ns=start_ns)
    if FAULTS in allowed:
        acts = _growing(folder / FAULT_ACTS, stack)
        write = _replacing(folder / FAULT_RECORD)
        write(record_text(()))
        faults = FaultsByHand(acts.lines, write, targets, places)
    return TrainByHand(desk, faults)


def _growing(path: Path, stack: ExitStack) -> GrowingFile:
    file = GrowingFile(path)
    stack.callback(file.close)
    return file


def _replacing(path: Path) -> Callable[[str], None]:
    """Return a function that replaces a file at once. It never waits for the disk, because the
    train runs meanwhile.
    """
    part = path.with_name(f".part.{path.name}")

    def replace(text: str) -> None:
        part.write_text(text, encoding="utf-8")
        part.replace(path)

    return replace
