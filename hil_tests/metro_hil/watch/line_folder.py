"""The page of a line's run, from the files in its folder."""

import tomllib
from pathlib import Path
from typing import Any, Final

import msgspec

from canlog.damage import LogError
from canlog.views.place import doubts_of
from firmware_py.clock.clock import WallClock
from firmware_py.radio.credentials import load_credentials
from firmware_py.radio.line_keys import line_keys
from firmware_py.settings import SettingsError
from firmware_py.trackdb import load_line
from firmware_py.trackdb.areas import load_areas
from metro_hil.supervision.view import LineView
from metro_hil.watch.line_picture import head_of
from metro_hil.watch.line_server import LineServer
from metro_hil.watch.line_source import LINE_LOG, FolderSource
from zenoh_config.codec import SafetyKey
from zenoh_config.secured import SUPERVISION_NAME

CONFIG: Final = "run.toml"
PROCESSES: Final = "processes"


class _Options(msgspec.Struct):
    line: str
    secure: str | None = None
    insecure: bool = False


class _Line(msgspec.Struct):
    line_radio: str | None = None


class _Config(msgspec.Struct):
    """The parts of run.toml that the page needs."""

    bench: str
    options: _Options
    line: _Line


def is_line_run(folder: Path) -> bool:
    return (folder / LINE_LOG).is_file()


def serve_line_folder(
    folder: Path, *, host: str, port: int = 0, commands: bool = False
) -> LineServer:
    """Return the server of the page of a line's run, which may still go on.

    Raises:
        LogError: if the folder cannot be read, or the port is taken.
    """
    config, clock = _config(folder / CONFIG), WallClock()
    try:
        areas, line = load_areas(config.options.line), load_line(config.options.line)
        key = _key(config.options.secure, clock.epoch_ns())
    except SettingsError as error:
        raise LogError(f"{folder / CONFIG}: {error}") from error
    return LineServer(
        LineView(areas, key),
        FolderSource(
            *(folder, clock),
            real_time=config.bench == PROCESSES,
            doubt=" ".join(doubts_of(folder)),
        ),
        head_of(line, areas),
        command_line=_command_line(config) if commands else None,
        listen=host,
        port_number=port,
    )


def _config(path: Path) -> _Config:
    """Raises LogError."""
    try:
        return msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), _Config)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror}; the page needs the name of the line") from error
    except (ValueError, msgspec.ValidationError) as error:
        raise LogError(f"{path}: {error}; another version may have written it") from error


def _key(secure: str | None, epoch_ns: int) -> SafetyKey:
    """Return the key of the line's messages. Raises SettingsError."""
    if secure is None:
        return line_keys(None)
    return line_keys(load_credentials(Path(secure), SUPERVISION_NAME, epoch_ns))


def _command_line(config: _Config) -> list[str]:
    """Return the options by which a command reaches the line of the run."""
    options: dict[str, Any] = {
        "--line": config.options.line,
        "--line-radio": config.line.line_radio,
        "--secure": config.options.secure,
    }
    words = [word for name, value in options.items() if value for word in (name, value)]
    return [*words, *(["--insecure"] if config.options.insecure else [])]
