"""Loads what a run needs and checks that its parts fit, before anything is started."""

from collections.abc import Sequence
from dataclasses import dataclass

from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap, Station, load_line
from metro_hil.measures import stations_of
from metro_hil.options import RunOptions


@dataclass(frozen=True, slots=True)
class Journey:
    """One way along one line."""

    line: LineMap
    start: Station
    end: Station
    stops: Sequence[Station]
    """Where the train shall stop, in running order; the last is `end`."""


def plan_journey(options: RunOptions) -> Journey:
    """Raises SettingsError when line and stations do not fit together."""
    line = load_line(options.line)
    start = _station(line, options.start or line.stations[0].name, "--from")
    end = _station(line, options.end or line.stations[-1].name, "--to")
    if end.stop_m <= start.stop_m:
        raise SettingsError(
            f"--from {start.name} --to {end.name}: {end.name} at {end.stop_m} m is not "
            f"beyond {start.name} at {start.stop_m} m; trains run towards growing chainage"
        )
    return Journey(line, start, end, stations_of(line, start.name, end.name))


def _station(line: LineMap, name: str, option: str) -> Station:
    try:
        return line.station(name)
    except KeyError as error:
        raise SettingsError(f"{option} {name}: {error.args[0]}") from None
