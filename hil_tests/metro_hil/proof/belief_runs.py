"""Runs scenarios with a controller that has wrong data: map, train parameters or scales.

The plant, the monitors and the judge keep the true data. A scenario notices a mistake when one of
its cases passes with the right data and fails with the wrong data.
"""

import dataclasses
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, cast

import can_dbc.codec
from can_dbc import doors, odometer, traction
from can_dbc.binding import Frame
from can_dbc.packing import Unpack, unpacker
from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap
from metro_hil.campaign.plan import plan_cases
from metro_hil.campaign.read import read_campaign
from metro_hil.model.case import Case, CaseResult, Verdict
from metro_hil.model.case_setup import CaseParts, parts_of
from metro_hil.run.case import CaseRun

FRAMES: Final[dict[str, type[Frame]]] = {
    kind.__name__: kind
    for kind in (
        odometer.Tacho,
        odometer.Doppler,
        odometer.Imu,
        odometer.ColdMovement,
        traction.TractionStatus,
        doors.DoorStatus,
    )
}
"""Frames that only the controller receives, so that a wrong scale affects it alone."""

Mistake = Callable[[CaseParts], CaseParts]


@dataclasses.dataclass(frozen=True, slots=True)
class BeliefRun:
    """A case, and the files that it names."""

    case: Case
    contents: Mapping[str, str]


def rides_of(name: str) -> list[BeliefRun]:
    """Return the cases of `campaign: case`, where a prefix of the case id is enough.

    Raises KeyError.
    """
    name, _, begin = name.partition(": ")
    campaign = read_campaign(name)
    cases = [case for case in plan_cases(campaign) if case.id.startswith(begin)]
    if not cases:
        raise KeyError(f"{begin!r} is not a case of {name}")
    return [BeliefRun(case, campaign.files) for case in cases]


def notices(
    names: Sequence[str], mistaken: Callable[[BeliefRun], CaseResult | None], known_good: set[str]
) -> str:
    """Return the first case that passes only without the mistake, with the reason; else nothing.

    Args:
        mistaken: runs a case with the mistake.
        known_good: cases that pass without any mistake; grows.
    """
    for ride in (ride for name in names for ride in rides_of(name)):
        result = mistaken(ride)
        if result is not None and result.verdict is not Verdict.FAIL:
            continue
        if ride.case.id not in known_good:
            right = run(ride)
            if right is None or right.verdict is not Verdict.PASS:
                continue
            known_good.add(ride.case.id)
        return f"{ride.case.id}: {'refused on loading' if result is None else failed_of(result)}"
    return ""


def run(ride: BeliefRun, mistake: Mistake = lambda parts: parts) -> CaseResult | None:
    """Run a case; return None if the controller rejects the mistake when it starts."""
    with tempfile.TemporaryDirectory() as folder:
        files = {name: Path(folder) / name for name in ride.contents}
        for name, path in files.items():
            path.write_text(ride.contents[name], encoding="utf-8")
        try:
            parts = mistake(parts_of(ride.case, files))
            case_run = CaseRun(ride.case, parts, None)
        except (ValueError, SettingsError):
            return None
        try:
            case_run.to_end()
        finally:
            case_run.close()
        return case_run.result()


def failed_of(result: CaseResult) -> str:
    """Return the names of the monitors that failed."""
    failed = [each.name for each in result.monitors if each.verdict is Verdict.FAIL]
    return ", ".join(failed) or result.reason


def with_line(parts: CaseParts, line: LineMap) -> CaseParts:
    """Give this map to controller and wayside, which refuse each other with different maps."""
    by_name = {station.name: station for station in line.stations}
    right = parts.journey
    mission = dataclasses.replace(
        right.mission,
        start=by_name[right.mission.start.name],
        stops=tuple(by_name[stop.name] for stop in right.mission.stops),
    )
    return dataclasses.replace(
        parts,
        journey=dataclasses.replace(right, line=line, mission=mission),
        scenario=dataclasses.replace(parts.scenario, wayside_line=line),
    )


@contextmanager
def misread(kind: type[Frame], field: str, change: Callable[[float], float]) -> Iterator[None]:
    """Let decoders that are created meanwhile read one value of one frame wrongly."""

    def wrongly(asked: type[Frame]) -> Unpack:
        unpack = unpacker(asked)
        if asked is not kind:
            return unpack

        def read(bits: int) -> Frame | None:
            heard: Any = unpack(bits)
            if heard is not None:
                heard = dataclasses.replace(heard, **{field: change(getattr(heard, field))})
            return cast("Frame | None", heard)

        return read

    codec: Any = can_dbc.codec
    right = codec.unpacker
    codec.unpacker = wrongly
    try:
        yield
    finally:
        codec.unpacker = right
