"""The lines, trains and parameters that a campaign names, each read once."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Final, TypeVar

from firmware_py.settings import SettingsError, is_path
from firmware_py.trackdb import LineMap, load_line
from firmware_py.trackdb.circuit import split_route, with_route
from metro_hil.campaign.fit import FaultCheck
from metro_hil.model.service import PlannedTrip, line_of_service, load_service
from plant_emulator.desk.recording import DeskRecording, load_recording
from plant_emulator.power.supplies import Supply, load_supply
from plant_emulator.train_config import TrainConfig, load_train
from vobc.config import VobcConfig, load_config

T = TypeVar("T")
SHIPPED: Final = ("line", "consist", "params", "supply")
"""Kinds of files of which some ship, named by their stem; all others are files of the user."""


class Sources:
    """Gives the user's files names that are equal on every machine; shipped files keep theirs."""

    def __init__(self, folder: Path) -> None:
        """`folder` is that of the campaign's file; relative paths start there."""
        self._folder = folder
        self.files: dict[str, str] = {}
        """Contents of the user's files, by their names in the cases."""
        self.paths: dict[str, Path] = {}
        self.faults = FaultCheck(self.paths)
        self._names: dict[str, str] = {}
        self._read: dict[tuple[str, str], object] = {}

    def line(self, written: str) -> tuple[str, LineMap]:
        """Name for the case, and the line. Raises SettingsError."""
        return self._get("line", written, load_line)

    def train(self, written: str) -> tuple[str, TrainConfig]:
        return self._get("consist", written, load_train)

    def params(self, written: str) -> tuple[str, VobcConfig]:
        return self._get("params", written, load_config)

    def recording(self, written: str) -> tuple[str, DeskRecording]:
        """Name and content of a desk recording, which is always a file of the user."""
        return self._get("desk_recording", written, load_recording)

    def service(self, written: str, line: str) -> tuple[str, tuple[PlannedTrip, ...]]:
        """Name and trips of a service on a line, which is always a file of the user."""
        on_line = str(self._folder / line) if is_path(line) else line
        return self._get("service", written, lambda path: load_service(path, on_line))

    def supply(self, written: str) -> tuple[str, Supply]:
        return self._get("supply", written, load_supply)

    def line_of_service(self, written: str) -> str:
        """The line that a service names, as a campaign in its folder would write it."""
        named = line_of_service(str(self._folder / written))
        return str(Path(named).relative_to(self._folder)) if is_path(named) else named

    def _get(self, what: str, written: str, load: Callable[[str], T]) -> tuple[str, T]:
        key = (what, written)
        if key not in self._read:
            try:
                self._read[key] = self._load(what, written, load)
            except SettingsError as error:
                self._read[key] = error
        kept = self._read[key]
        if isinstance(kept, SettingsError):
            raise kept
        assert isinstance(kept, tuple)
        return kept

    def _load(self, what: str, written: str, load: Callable[[str], T]) -> tuple[str, T]:
        base, route = split_route(written) if what == "line" else (written, None)
        ships = what in SHIPPED and not (base.endswith(".toml") or "/" in base)
        if ships:
            return written, load(written)
        path = self._folder / base
        loaded = load(with_route(str(path), route))
        return with_route(self._name(path), route), loaded

    def _name(self, path: Path) -> str:
        """The file's own name, with part of its hash if another file has the same name."""
        content = path.read_text(encoding="utf-8")
        name = path.name if path.suffix in (".toml", ".desk") else f"{path.name}.toml"
        if self.files.get(name, content) != content:
            digest = hashlib.sha256(content.encode()).hexdigest()[:8]
            stem, _, ending = name.rpartition(".")
            name = f"{stem}-{digest}.{ending}"
        self.files[name] = content
        self.paths[name] = path
        return name
