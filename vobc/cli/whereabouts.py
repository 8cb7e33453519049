"""Place of the train at the start, from the command line and from the board's memory."""

from dataclasses import dataclass

from firmware_py.storage.nvram import Nvram, NvramState
from firmware_py.trackdb import LineMap
from vobc.config import VobcConfig, plan_mission
from vobc.process import remembered_start, unknown_start
from vobc.process.identity import identity_of
from vobc.vocabulary import OdometryRecord


@dataclass(frozen=True, slots=True)
class Whereabouts:
    start: OdometryRecord | None
    """Place of the train. None: the start of the mission, as given by --from."""
    first: str | None
    """Station where the mission starts. None: the first station of the line."""
    note: str = ""
    """Why --from was ignored, or that the memory belongs to another train, line or version."""


def whereabouts(
    config: VobcConfig, line: LineMap, nvram: Nvram, said: str | None, path: str | None
) -> Whereabouts:
    """Determine the place. The memory overrules --from.

    A command that is repeated with the same --from would otherwise put the train back to its first
    start.

    Args:
        said: station of `--from`. SettingsError is raised if it is not on the line.
        path: path of the memory, for messages.
    """
    if nvram.state is NvramState.ABSENT:
        return Whereabouts(None, said)
    remembered = None
    if nvram.state is NvramState.OK:
        remembered = remembered_start(config, line, nvram.record)
    if remembered is None:
        start = unknown_start(config, line, nvram.record)
        foreign = identity_of(config, line).foreign(nvram.record)
        why = f"{path}: {foreign or 'the last run did not end at a proven standstill'}"
        why = f"the train may stand anywhere: {nvram.detail or why}"
        note = _note(said, path, why) or (why if foreign else "")
        return Whereabouts(start, said, note)
    if said is not None and _agree(config, line, remembered, said):
        return Whereabouts(None, said)
    near = min(line.stations, key=lambda station: abs(station.stop_m - remembered.front_m)).name
    why = f"by {path} it was switched off at {remembered.front_m:.1f} m, nearest to {near}"
    return Whereabouts(remembered, near, _note(said, path, why))


def _note(said: str | None, path: str | None, why: str) -> str:
    if said is None:
        return ""
    advice = f"remove {path} only after checking on site that the train stands at {said}"
    return f"--from {said} is ignored: {why}; {advice}"


def _agree(config: VobcConfig, line: LineMap, remembered: OdometryRecord, said: str) -> bool:
    stop_m = plan_mission(line, said, None).start.stop_m
    return abs(stop_m - remembered.front_m) <= config.odometry.start_bound_m
