"""The state of a line as its page gets it, and the events between two such states."""

from collections.abc import Iterator
from typing import Any

import msgspec

from can_dbc.vobc import Supervision
from firmware_py.trackdb import LineMap
from firmware_py.trackdb.areas import AreaMap
from metro_hil.supervision.view import (
    KMH,
    NS_PER_S,
    LineView,
    protection_words,
    silence_words,
)
from zenoh_config.t2t import NO_TRAIN, Phase, TrainReport


class AreaPicture(msgspec.Struct, frozen=True):
    """One area and its master, according to the newest heartbeat."""

    area: int
    master: int = NO_TRAIN
    """0: no heartbeat was received yet."""
    standby: int = NO_TRAIN
    term: int = 0
    issuing: bool = False
    """Whether the master issues authorities; a train that takes over does not yet."""
    age_s: float = 0.0
    """Age of the newest heartbeat."""
    silence: str = ""
    why: str = ""
    """Why and for how long the master has commanded the area; empty if unknown."""


class TrainPicture(msgspec.Struct, frozen=True):
    """One train, according to its newest report."""

    train: int
    localised: bool
    rear_min_m: float
    front_min_m: float
    front_max_m: float
    authority_m: float | None
    """End of the authority that the train holds; None without one."""
    speed_kmh: float
    area: int
    term: int
    age_s: float
    """Age of the report."""
    silence: str
    latency_ms: float | None
    """Time from the newest answered report to the authority; None for a train that gets none."""
    latency_max_ms: float | None
    """The greatest latency of the last minute."""
    protection: str
    """State of ATP and its cause; empty while it is nominal or not received."""
    emergency: bool
    what: str
    """Mode, state of ATP, commands for the train, and what it waits for."""


class TrackPicture(msgspec.Struct, frozen=True):
    """What the wayside reports of the track."""

    wayside: str
    """Why no command is possible; empty while the wayside is received."""
    objects: tuple[tuple[int, str], ...]
    """Number and state of each object."""
    restrictions: tuple[tuple[float, float, float], ...]
    """Start, end in metres, and limit in km/h."""
    closed: tuple[tuple[float, float], ...]
    """Start and end in metres."""


class LinePicture(msgspec.Struct, frozen=True):
    connected: bool
    """Whether there is a session with the wayside's router."""
    areas: tuple[AreaPicture, ...]
    trains: tuple[TrainPicture, ...]
    """The foremost first."""
    track: TrackPicture
    unseen: tuple[str, ...]
    """A text for each train that should send reports but does not."""


def picture_of(view: LineView, now_ns: int, *, connected: bool) -> LinePicture:
    reports = sorted(view.reports.values(), key=lambda each: -each[0].front_max_m)
    return LinePicture(
        connected,
        tuple([_area(view, area.number, now_ns) for area in view.areas.areas]),
        tuple([_train(view, report, at_ns, now_ns) for report, at_ns in reports]),
        _track(view, now_ns),
        tuple(view.unseen(now_ns)),
    )


def head_of(line: LineMap, areas: AreaMap) -> dict[str, Any]:
    """Return what never changes while the page is served."""
    return {
        "line": line.name,
        "span": [areas.start_m, areas.end_m],
        "stations": [[each.name, each.stop_m] for each in line.stations],
        "areas": [[each.number, each.start_m, each.end_m] for each in areas.areas],
        "objects": [
            [each.number, each.kind.name.lower(), each.start_m, each.end_m]
            for each in areas.objects
        ],
    }


def _area(view: LineView, area: int, now_ns: int) -> AreaPicture:
    command = view.commands.get(area)
    if command is None:
        return AreaPicture(area)
    beat, reason = command.heartbeat, view.reason(area)
    return AreaPicture(
        area=area,
        master=beat.source,
        standby=beat.standby,
        term=beat.term,
        issuing=beat.phase is Phase.ISSUING,
        age_s=(now_ns - command.heard_ns) / NS_PER_S,
        silence=silence_words(command.heard_ns, now_ns),
        why="" if reason is None else f"for {reason[0]:.0f} s, because {reason[1]}",
    )


def _train(view: LineView, report: TrainReport, at_ns: int, now_ns: int) -> TrainPicture:
    status = view.status(report.source, now_ns)
    late_ms = [each.duration_ms for each in view.latencies.get(report.source, ())]
    return TrainPicture(
        train=report.source,
        localised=report.localised,
        rear_min_m=report.rear_min_m,
        front_min_m=report.front_min_m,
        front_max_m=report.front_max_m,
        authority_m=view.authority_end(report),
        speed_kmh=report.speed_mps * KMH,
        area=report.area,
        term=report.term,
        age_s=(now_ns - at_ns) / NS_PER_S,
        silence=silence_words(at_ns, now_ns),
        latency_ms=late_ms[-1] if late_ms else None,
        latency_max_ms=max(late_ms, default=None),
        protection="" if status is None else protection_words(status),
        emergency=status is not None and status.supervision == Supervision.EMERGENCY,
        what=view.state_words(report, now_ns),
    )


def _track(view: LineView, now_ns: int) -> TrackPicture:
    state = view.state
    restrictions, closed = ((), ()) if state is None else (state.restrictions, state.closed)
    return TrackPicture(
        wayside=view.wayside_words(now_ns),
        objects=tuple([(n, view.object_words(n, now_ns)) for n in sorted(view.objects)]),
        restrictions=tuple([(s.start_m, s.end_m, s.limit_mps * KMH) for s in restrictions]),
        closed=tuple([(s.start_m, s.end_m) for s in closed]),
    )


def changes(before: LinePicture, now: LinePicture) -> list[str]:
    """Return a sentence for each event that lies between the two states."""
    found = []
    if before.connected != now.connected:
        found.append(
            "the session is back" if now.connected else "the session with the line is lost"
        )
    for old, new in zip(before.areas, now.areas, strict=True):
        found += _area_changes(old, new)
    known = {each.train: each for each in before.trains}
    for train in now.trains:
        found += _train_changes(known.get(train.train), train)
    return [*found, *_track_changes(before.track, now.track)]


def _area_changes(old: AreaPicture, new: AreaPicture) -> Iterator[str]:
    area, does = f"area {new.area}", "commands" if new.issuing else "takes over"
    if new.silence and not old.silence:
        yield f"{area}: its master, train {new.master}, is silent"
    elif new.master == NO_TRAIN:
        return
    elif old.master == NO_TRAIN:
        yield f"{area}: train {new.master} {does}, term {new.term}"
    elif new.master != old.master:
        yield f"{area}: train {new.master} {does} after train {old.master}, term {new.term}"
    elif new.term != old.term:
        yield f"{area}: train {new.master} {does} again, term {new.term}"
    elif new.issuing and not old.issuing:
        yield f"{area}: train {new.master} commands, term {new.term}"
    elif old.silence and not new.silence:
        yield f"{area}: its master, train {new.master}, is received again"
    elif new.standby != old.standby:
        standby = f"train {new.standby}" if new.standby else "none"
        yield f"{area}: standby is {standby}"


def _train_changes(old: TrainPicture | None, new: TrainPicture) -> Iterator[str]:
    name = f"train {new.train}"
    if old is None:
        yield f"{name} is received"
        return
    if bool(old.silence) != bool(new.silence):
        yield f"{name} is {'silent' if new.silence else 'received again'}"
    if old.localised != new.localised:
        yield f"{name} {'knows' if new.localised else 'lost'} its place"
    if old.protection != new.protection and (old.emergency or new.emergency):
        yield f"{name}: {new.protection or 'protection is nominal'}"


def _track_changes(old: TrackPicture, new: TrackPicture) -> Iterator[str]:
    if bool(old.wayside) != bool(new.wayside):
        yield new.wayside or "the wayside is received"
    for start_m, end_m, limit_kmh in sorted({*old.restrictions} ^ {*new.restrictions}):
        ends = "" if (start_m, end_m, limit_kmh) in new.restrictions else " no longer holds"
        yield f"at most {limit_kmh:g} km/h from {start_m:g} to {end_m:g} m{ends}"
    for start_m, end_m in sorted({*old.closed} ^ {*new.closed}):
        state = "closed" if (start_m, end_m) in new.closed else "open again"
        yield f"{state} from {start_m:g} to {end_m:g} m"
