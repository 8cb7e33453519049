"""Where the train stands at the start: what a person says, and what the board remembers."""

from dataclasses import dataclass

from firmware_py.storage.nvram import Nvram, NvramState
from firmware_py.trackdb import LineMap
from vobc.config import VobcConfig, plan_mission
from vobc.process import remembered_start, unknown_start
from vobc.vocabulary import OdometryRecord


@dataclass(frozen=True, slots=True)
class Whereabouts:
    start: OdometryRecord | None
    """None: where the mission starts, as a person said."""
    first: str | None
    """Where the mission starts; None: at the first station of the line."""
    note: str = ""
    """Why a person was not believed."""


def whereabouts(
    config: VobcConfig, line: LineMap, nvram: Nvram, said: str | None, path: str | None
) -> Whereabouts:
    """A person is not believed against a memory: whoever starts a train again with the words of its
    first start would put it back to where it has left.

    Args:
        said: the station of `--from`; SettingsError is raised for one that is not on the line.
        path: of the memory, for people.
    """
    if nvram.state is NvramState.ABSENT:
        return Whereabouts(None, said)
    remembered = None
    if nvram.state is NvramState.OK:
        remembered = remembered_start(config, nvram.record)
    if remembered is None:
        start = unknown_start(config, line, nvram.record)
        why = nvram.detail or f"{path}: the last run did not end at a proven standstill"
        return Whereabouts(start, said, _note(said, path, f"the train may stand anywhere: {why}"))
    if said is not None and _agree(config, line, remembered, said):
        return Whereabouts(None, said)
    near = min(line.stations, key=lambda station: abs(station.stop_m - remembered.front_m)).name
    why = f"by {path} it was switched off at {remembered.front_m:.1f} m, nearest to {near}"
    return Whereabouts(remembered, near, _note(said, path, why))


def _note(said: str | None, path: str | None, why: str) -> str:
    if said is None:
        return ""
    advice = f"remove {path} once somebody has seen that the train stands at {said}"
    return f"--from {said} is not believed: {why}; {advice}"


def _agree(config: VobcConfig, line: LineMap, remembered: OdometryRecord, said: str) -> bool:
    stop_m = plan_mission(line, said, None).start.stop_m
    return abs(stop_m - remembered.front_m) <= config.odometry.start_bound_m
