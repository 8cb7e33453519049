"""The folder that a run leaves: configuration, logs, plot and results under fixed names."""

import dataclasses
import enum
import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from firmware_py.arguments import DISK_FAULTS
from firmware_py.storage.whole_file import write_whole

PACKAGES = ("metro-vobc-bench", "python-can", "cantools", "numpy", "pyserial", "eclipse-zenoh")


class RunFolderError(Exception):
    """The folder cannot be made or written; the text names it."""


@dataclasses.dataclass(frozen=True, slots=True)
class RunFolder:
    """Paths of the files of one run."""

    path: Path

    @property
    def config(self) -> Path:
        return self.path / "run.toml"

    @property
    def bus_log(self) -> Path:
        return self.path / "bus.log"

    @property
    def serial_log(self) -> Path:
        return self.path / "serial.log"

    @property
    def cycle_log(self) -> Path:
        return self.path / "cycles.csv"

    @property
    def events_log(self) -> Path:
        return self.path / "events.jsonl"

    @property
    def truth_log(self) -> Path:
        return self.path / "truth.csv"

    @property
    def host_log(self) -> Path:
        return self.path / "host.csv"

    @property
    def plot(self) -> Path:
        return self.path / "run.png"

    @property
    def results(self) -> Path:
        return self.path / "results.json"


def make_run_folder(out: str | None, epoch_ns: int, words: str) -> RunFolder:
    """Make a new folder: `out`, or one below `runs/` named by date, time and `words`.

    Raises:
        RunFolderError: if it is not empty, or cannot be made.
    """
    stamp = utc_text(epoch_ns).replace(":", "-")
    path = Path(out) if out else Path("runs") / f"{stamp}_{words}"
    try:
        if not out:
            return RunFolder(_made_under_free_name(path))
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            raise RunFolderError(f"--out {path}: not empty; a run never overwrites another")
    except OSError as error:
        if error.errno in DISK_FAULTS:
            raise
        raise RunFolderError(f"--out {path}: cannot be made: {error.strerror}") from error
    return RunFolder(path)


def discard_unused(folder: RunFolder) -> None:
    """Remove the folder of a run that never began, if it holds only run.toml and empty logs."""
    made = list(folder.path.iterdir())
    if all(path == folder.config or path.stat().st_size == 0 for path in made):
        for path in made:
            path.unlink()
        folder.path.rmdir()
        # Imported here, because this module brings all log readers along.
        from canlog.run_names import forget_removed

        forget_removed()


def utc_text(epoch_ns: int) -> str:
    """Date and time of an instant, to the second, in UTC."""
    return str(np.datetime64(epoch_ns // 1_000_000_000, "s"))


def _made_under_free_name(path: Path) -> Path:
    """Another run may begin in the same second, but only one of them can make a folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    number, free = 1, path
    while True:
        try:
            free.mkdir()
        except FileExistsError:
            number += 1
            free = path.with_name(f"{path.name}_{number}")
        else:
            return free


def write_config(folder: RunFolder, tables: Mapping[str, object], epoch_ns: int) -> None:
    """Write run.toml: the effective configuration, versions and host."""
    document = {
        "started": utc_text(epoch_ns) + "Z",
        **{name: plain(value) for name, value in tables.items()},
        "versions": versions(),
        "host": {
            "system": platform.platform(),
            "machine": platform.machine(),
            "processors": os.cpu_count() or 0,
        },
    }
    write_whole(folder.config, tomli_w.dumps(document))


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that shape a run."""
    # Imported here, because it brings the standard library's e-mail package along.
    from importlib import metadata

    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed as a package"
    return found


def plain(value: object) -> Any:
    """Convert dataclasses, enums and paths to TOML or JSON values; None is left out."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            field.name: plain(getattr(value, field.name))
            for field in dataclasses.fields(value)
            if field.init and getattr(value, field.name) is not None
        }
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items() if item is not None}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    return value
