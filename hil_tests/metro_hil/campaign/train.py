"""Checks `[train]` and `[timetable]` of a scenario against the line and trains that they name."""

from collections.abc import Callable, Mapping
from typing import Any, Final, TypeVar

import msgspec

from firmware_py import settings
from firmware_py.settings import SettingsError, nearest, override, unknown_key
from firmware_py.trackdb import LineMap
from firmware_py.trackdb.circuit import load_network, split_route, with_route
from metro_hil.campaign.problems import Findings, attempt, salvage
from metro_hil.campaign.schema import OVERRIDES, TRAIN, TimetableKeys, TrainKeys
from metro_hil.campaign.sources import Sources
from metro_hil.model.case import Setup
from metro_hil.model.network_supply import check_supply
from metro_hil.model.service import needs_switches, read_service
from plant_emulator.train_config import TrainConfig
from vobc.config import VobcConfig
from vobc.plausible import implausible

T = TypeVar("T")
OF_SERVICE: Final = (
    *("service", "trains", "supply"),
    *("masters", "cut_master_at_s", "kill_master_at_s"),
)
"""Keys that are those of all trips together."""
DEFAULT = Setup()


def read_setup(raw: Mapping[str, Any], sources: Sources, findings: Findings) -> Setup | None:
    """The setup of a case; None if anything is wrong with it."""
    before = len(findings.found)
    train, timetable = raw.get("train", {}), raw.get("timetable", {})
    given = _given(train, timetable, findings)
    given |= {name: dict(train[name]) for name in OVERRIDES if name in train}
    setup = Setup(**given)
    if setup.service is not None:
        return _read_service(setup, train, timetable, sources, findings)
    line = _named(sources.line, "line", setup.line, findings)
    consist = _named(sources.train, "consist", setup.consist, findings)
    params = _named(sources.params, "params", setup.params, findings)
    played = setup.desk_recording
    if played is not None:
        recording = _named(sources.recording, "desk_recording", played, findings)
        if recording is not None:
            setup = msgspec.structs.replace(setup, desk_recording=recording[0])
    if setup.memory_line is not None:
        remembered = _named(sources.line, "memory_line", setup.memory_line, findings)
        if remembered is not None:
            setup = msgspec.structs.replace(setup, memory_line=remembered[0])
    if line is None or consist is None or params is None:
        return None
    config = _believed(setup, params[1], findings)
    real = _real_train(setup, consist[1], findings)
    setup = _check_stations(setup, line[1], real, findings)
    if config is not None:
        for text in implausible(config, line[1].for_train(config.train.length_m)):
            findings.add("train", text)
    if len(findings.found) > before:
        return None
    return msgspec.structs.replace(setup, line=line[0], consist=consist[0], params=params[0])


def _read_service(
    setup: Setup,
    train: Mapping[str, Any],
    timetable: Mapping[str, Any],
    sources: Sources,
    findings: Findings,
) -> Setup | None:
    """The setup of a case with a service: each trip fits the train and its parameters."""
    before = len(findings.found)
    assert setup.service is not None
    if timetable:
        findings.add("timetable", "is decided by train.service; leave it out")
    try:
        written = str(train["line"] if "line" in train else sources.line_of_service(setup.service))
        if split_route(written)[1] is not None:
            raise SettingsError(f"line {written!r} names a route; each trip names its own")
        name, trips = sources.service(setup.service, written)
    except (SettingsError, ValueError) as error:
        findings.add("train.service", str(error))
        return None
    reads: list[Setup] = []
    for trip in trips:
        _, route = split_route(trip.line)
        alone = {**train, "line": with_route(written, route), "start": trip.start, "end": trip.end}
        for key in OF_SERVICE:
            alone.pop(key, None)
        table = {"dwell_s": dict(trip.dwell_s), "run_s": dict(trip.run_s)}
        read = read_setup({"train": alone, "timetable": table}, sources, findings)
        if read is None or len(findings.found) > before:
            return None
        reads.append(read)
    trains = setup.trains or read_service(str(sources.paths[name])).trains
    network = load_network(split_route(trips[0].line)[0])
    together = setup.masters or setup.supply is not None
    if (trains > 1 or together) and not network.switches:
        findings.add("train.service", needs_switches(trains, written))
        return None
    kept = {key: getattr(setup, key) for key in OF_SERVICE if key != "service"}
    if setup.supply is not None:
        supply = _named(sources.supply, "supply", setup.supply, findings)
        if supply is None:
            return None
        try:
            check_supply(supply[1], setup.supply, network, trips)
        except SettingsError as error:
            findings.add("train.supply", str(error))
            return None
        kept["supply"] = supply[0]
    return msgspec.structs.replace(
        reads[0], service=name, start=None, end=None, dwell_s={}, run_s={}, **kept
    )


def _given(
    train: Mapping[str, Any], timetable: Mapping[str, Any], findings: Findings
) -> dict[str, Any]:
    """The valid keys that the file gives, by field of Setup."""
    plain = {name: value for name, value in train.items() if name not in OVERRIDES}
    for name in [name for name in plain if name not in TRAIN]:
        findings.add(f"train.{name}", unknown_key(name, list(TRAIN)))
        del plain[name]
    keys, train_given = salvage(
        lambda t: settings.build(TrainKeys, t, "", "train"), plain, "train", findings
    )
    times, times_given = salvage(
        lambda t: settings.build(TimetableKeys, t, "", "timetable"),
        timetable,
        "timetable",
        findings,
    )
    given = {name: getattr(keys, name) for name in train_given}
    if keys is not None and "desk_mode" in given:
        given["desk_mode"] = keys.desk_mode.name.lower()
    return given | {name: getattr(times, name) for name in times_given}


def _named(
    get: Callable[[str], tuple[str, T]], what: str, written: str, findings: Findings
) -> tuple[str, T] | None:
    try:
        return get(written)
    except SettingsError as error:
        findings.add(f"train.{what}", str(error))
        return None


def _believed(setup: Setup, params: VobcConfig, findings: Findings) -> VobcConfig | None:
    key = "train.believed"
    return attempt(lambda table: override(params, table, key), setup.believed, key, findings)


def _real_train(setup: Setup, train: TrainConfig, findings: Findings) -> TrainConfig:
    key = "train.real"
    made = attempt(lambda table: override(train, table, key), setup.real, key, findings)
    return train if made is None else made


def _check_stations(setup: Setup, line: LineMap, train: TrainConfig, findings: Findings) -> Setup:
    """Check that start, end, stops and timed stations exist, and that stops are in running order.

    A timetable without an end ends at its last stop.
    """
    names = [station.name for station in line.stations]
    stops = list(setup.stops or ())
    end = setup.end if setup.end is not None or not stops else stops[-1]
    places = {
        "train.start": [] if setup.start is None else [setup.start],
        "train.end": [] if setup.end is None else [setup.end],
        "timetable.stops": stops,
        "timetable.dwell_s": list(setup.dwell_s),
        "timetable.run_s": list(setup.run_s),
    }
    unknown = False
    for key, stations in places.items():
        for station in stations:
            if station not in names:
                unknown = True
                hint = nearest(station, names, "station")
                findings.add(key, f"{station!r} is no station of line {line.name}; {hint}")
    if not unknown:
        _check_way(setup, line, train, end, findings)
    return msgspec.structs.replace(setup, end=end)


def _check_way(
    setup: Setup, line: LineMap, train: TrainConfig, end: str | None, findings: Findings
) -> None:
    first = line.station(setup.start) if setup.start is not None else line.stations[0]
    last = line.station(end) if end is not None else line.stations[-1]
    if last.stop_m <= first.stop_m:
        findings.add(
            "train.end" if setup.end is not None or setup.stops is None else "timetable.stops",
            f"{last.name!r} lies at {last.stop_m:g} m, not beyond {first.name} at "
            f"{first.stop_m:g} m; trains run towards growing chainage",
        )
        return
    if first.stop_m - train.length_m < line.start_m:
        findings.add(
            "train.start",
            f"{first.name!r}: the train of {train.length_m:g} m reaches back over the line's "
            f"start at {line.start_m:g} m",
        )
    reached = first
    for name in setup.stops or ():
        station = line.station(name)
        if not reached.stop_m < station.stop_m <= last.stop_m:
            findings.add(
                "timetable.stops",
                f"{name!r} at {station.stop_m:g} m does not lie between {reached.name} and "
                f"{last.name} in running order",
            )
            return
        reached = station
    if setup.stops is not None and reached is not last:
        findings.add("timetable.stops", f"the last stop must be {last.name!r}, where the run ends")
