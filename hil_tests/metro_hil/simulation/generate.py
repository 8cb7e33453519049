"""Generates the line, trains, arbiters and timers of a seed; faults come from other modules."""

import hashlib
import itertools
import math
import random
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from firmware_py.trackdb.areas import (
    Area,
    AreaMap,
    Division,
    ObjectKind,
    ObjectSite,
    TrackSection,
)
from metro_hil.simulation.protocol_nodes import Guards, LineParticipants
from metro_hil.simulation.track import stretch
from metro_hil.simulation.true_train import Build
from metro_hil.simulation.world import Setting
from vobc.train_to_train.guards import MemberGuards, TrainAhead, TrainGuards
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.term_grants import GrantCheck, signer_from_seed
from zenoh_config.timers import TIMER_SETS, TIMERS_A, TIMERS_B

AREA_M: Final = 2000.0
SECTION_PIECES: Final = 8
"""Number of sections in each area."""
FIRST_ARBITER: Final = 65_001
FAULTS_S: Final = (1.0, 40.0)
"""Default range of the mean time between two faults, in seconds."""
WEATHER_MS: Final = 8.0
"""Part of a network budget that the good weather of a calm line takes, both ways."""
PLACES_M: Final = 10.0
"""Borders and objects lie at whole multiples of this."""


def line_of_areas(
    areas: int, *, objects: bool = True, area_m: float = AREA_M, pieces: int = SECTION_PIECES
) -> AreaMap:
    """Return areas of equal length, each divided into `pieces` sections.

    With `objects`, each area has one switch and one platform track.
    """
    length_m = areas * area_m
    sites: list[ObjectSite] = []
    for index in range(areas if objects else 0):
        at_m = index * area_m
        sites.append(
            ObjectSite(2 * index + 1, ObjectKind.SWITCH, at_m + 0.35 * area_m, at_m + 0.37 * area_m)
        )
        sites.append(
            ObjectSite(
                2 * index + 2, ObjectKind.PLATFORM, at_m + 0.7 * area_m, at_m + 0.76 * area_m
            )
        )
    return AreaMap(
        "simulated",
        tuple(Area(*each) for each in stretch(0.0, length_m, areas)),
        tuple(TrackSection(*each) for each in stretch(0.0, length_m, pieces * areas)),
        tuple(sites),
    )


class SampledRanges(NamedTuple):
    """Values from which lines and trains are sampled."""

    areas: Sequence[int]
    areas_m: Sequence[float]
    """Lengths of areas; a random length of up to 190 m is added to each."""
    objects: Sequence[int]
    """Number of objects in each area."""
    sections_m: Sequence[float]
    trains_m: Sequence[float]
    trains: tuple[int, int]
    """Minimum and maximum number of trains."""
    between_s: Sequence[float]


WIDE: Final = SampledRanges(
    areas=(1, 2, 2, 3, 3, 4),
    areas_m=(600.0, 900.0, 1300.0, 2000.0, 3000.0),
    objects=(0, 1, 2, 3),
    sections_m=(100.0, 150.0, 210.0, 250.0, 400.0),
    trains_m=(40.0, 80.0, 80.0, 120.0, 160.0),
    trains=(2, 7),
    between_s=(3.0, 6.0, 12.0, 12.0, 24.0),
)
DENSE: Final = SampledRanges(
    areas=(1, 2, 2, 3),
    areas_m=(600.0, 800.0, 1000.0, 1300.0, 1800.0),
    objects=(0, 0, 1, 2),
    sections_m=(60.0, 100.0, 150.0, 210.0, 400.0),
    trains_m=(30.0, 40.0, 60.0, 80.0, 120.0),
    trains=(3, 7),
    between_s=(1.0, 1.5, 2.0, 3.0),
)


def line_by_chance(rng: random.Random, span: SampledRanges = WIDE) -> AreaMap:
    """Return a line of random areas, with objects at random places, also at borders."""
    lengths_m = [
        rng.choice(span.areas_m) + PLACES_M * rng.randrange(20)
        for _ in range(rng.choice(span.areas))
    ]
    borders_m = tuple(itertools.accumulate(lengths_m, initial=0.0))
    sites: list[ObjectSite] = []
    for start_m, end_m in itertools.pairwise(borders_m):
        at_m = start_m
        for _ in range(rng.choice(span.objects)):
            at_m += PLACES_M * rng.randrange(int((end_m - at_m) / PLACES_M))
            until_m = min(end_m, at_m + PLACES_M * rng.randint(1, 15))
            sites.append(ObjectSite(len(sites) + 1, rng.choice(list(ObjectKind)), at_m, until_m))
            at_m = until_m
            if at_m >= end_m:
                break
    section_m = rng.choice(span.sections_m)
    apply_m = rng.choice((400.0, 800.0, 800.0, 1200.0))
    return Division("by chance", borders_m, section_m, apply_m, tuple(sites)).area_map()


@dataclass(frozen=True, slots=True)
class Draw:
    """Line, trains and settings that a seed runs with."""

    cast: LineParticipants
    setting: Setting
    turn_ms: int = 3
    """Maximum time from the arrival of a message until the process reads its inbox."""
    leisurely: bool = False
    """Whether a train that is not the master wakes only for messages that concern it. Messages for
    masters then stay in its inbox, which gives nearly the same run in fewer steps."""
    between_s: float = 12.0
    """Mean time between two railway events."""
    ordered: bool = False
    """Whether supervision also takes trains out of service by command."""
    choosy: bool = False
    """Whether only some kinds of railway event happen, each with its own frequency. Sequences of
    one kind stay rare where every kind happens now and then."""
    sidings: bool = False
    """Whether trains are taken off the line and set on again elsewhere."""
    by_hand: bool = False
    """Whether trains are driven by hand up to the train ahead."""
    disturbed: bool = False
    """Whether axle counters are disturbed now and then."""
    faults_s: tuple[float, float] = FAULTS_S
    """Range of the mean time between two faults; see `FAULTS_S`."""
    foul_share: float = 0.0
    """Upper bound of the share of messages that links lose, delay or duplicate all the time. The
    affected links change during the run."""
    standing_ms: float = 0.0
    """Delay of every message, one way, for the whole run."""
    wayside_delayed: bool = False
    """Whether only messages from and to arbiters and wayside have that delay."""
    insider: int = 0
    """Address of a hostile train; 0 for none."""

    @property
    def timers(self) -> str:
        """Name of the timer set."""
        return next(n for n, each in TIMER_SETS.items() if each == self.cast.config.timers)


@dataclass(frozen=True, slots=True)
class Profile:
    """Features of the simulator that the runs of a seed use."""

    name: str
    even: bool = False
    """Whether areas and trains have equal length, with objects at the same places in each area."""
    ordered: bool = False
    """Whether supervision also takes trains out of service by command."""
    choosy: bool = False
    """Whether only some kinds of railway event happen, and some of them far more often."""
    sidings: bool = False
    """Whether trains leave the line anywhere, return elsewhere, and differ in length."""
    by_hand: bool = False
    """Whether trains are also driven by hand, on sight."""
    disturbed: bool = False
    """Whether axle counters are also disturbed."""
    dense: bool = False
    """Whether lines are shorter and denser, with far more events and faults. On some of these lines
    messages are lost or late all the time."""
    distant: bool = False
    """Whether every message takes up to what the timers' network budget allows, with all timer
    sets."""
    insider: bool = False
    """Whether one train sends forged messages, on a line without objects and without other
    faults."""


def _profiles() -> dict[str, Profile]:
    """Each profile has the features of the one before it, and one more."""
    found = {"even": Profile("even", even=True), "varied": Profile("varied")}
    latest = found["varied"]
    names = ("ordered", "choosy", "sidings", "by_hand", "disturbed", "dense", "distant", "insider")
    for name in names:
        latest = replace(latest, name=name.replace("_", "-"), **{name: True})
        found[latest.name] = latest
    return found


PROFILES: Final[Mapping[str, Profile]] = _profiles()
DEFAULT_PROFILES: Final = (
    (0, "even"),
    (10_000, "varied"),
    (20_000, "ordered"),
    (100_000, "choosy"),
    (110_000, "sidings"),
    (120_000, "by-hand"),
    (130_000, "disturbed"),
    (200_000, "dense"),
    (400_000, "distant"),
    (500_000, "insider"),
)
"""Default profile of the seeds from each number on. A seed that once failed runs the same again
with these."""


def default_profile(seed: int) -> Profile:
    """The profile of a seed when no profile is named."""
    place = bisect_right(DEFAULT_PROFILES, seed, key=lambda entry: entry[0])
    return PROFILES[DEFAULT_PROFILES[place - 1][1]]


def draw(seed: int, profile: Profile | None = None) -> Draw:
    """Generate everything that a seed runs with; equal seeds and profiles give equal results.

    Without a profile the number of the seed chooses it.
    """
    chosen = profile or default_profile(seed)
    drawn = _draw_even(seed) if chosen.even else _draw_any(seed, chosen)
    drawn = _distant(seed, drawn) if chosen.distant else drawn
    if chosen.insider:
        return _with_insider(seed, drawn)
    return _without_own_check(drawn) if seed % 2 else drawn


def _without_own_check(drawn: Draw) -> Draw:
    """Let trains obey masters without their own look ahead. It would hide what masters do wrong."""
    guards = Guards(TrainGuards(member=MemberGuards(behind_train_ahead_m=unbounded_m)))
    return replace(drawn, cast=replace(drawn.cast, guards=guards))


def unbounded_m(_: TrainAhead) -> float:
    return math.inf


def _distant(seed: int, drawn: Draw) -> Draw:
    """Sample timers and a delay. The budget covers the way, the weather and both programs."""
    rng = random.Random(seed ^ 0xD157)
    timers = TIMER_SETS[rng.choice(sorted(TIMER_SETS))]
    spare_ms = timers.round_trip_max_ms - 2.0 * drawn.turn_ms - WEATHER_MS
    config = replace(drawn.cast.config, timers=timers)
    return replace(
        drawn,
        cast=replace(drawn.cast, config=config),
        standing_ms=rng.uniform(0.0, spare_ms / 2.0),
        wayside_delayed=rng.random() < 0.3,
    )


def _with_insider(seed: int, drawn: Draw) -> Draw:
    rng = random.Random(seed ^ 0x1251DE)
    line = replace(drawn.cast.line, objects=())
    cast = with_signed_grants(replace(drawn.cast, line=line))
    return replace(drawn, cast=cast, insider=rng.choice(cast.trains))


def with_signed_grants(cast: LineParticipants) -> LineParticipants:
    """Let arbiters sign their grants, and trains obey no term without them."""
    made = {
        each: signer_from_seed(hashlib.sha256(f"arbiter {each}".encode()).digest())
        for each in cast.config.arbiters
    }
    check = GrantCheck({each: public for each, (_, public) in made.items()})
    signers = {each: signer for each, (signer, _) in made.items()}
    return replace(cast, config=replace(cast.config, grants=check), signers=signers)


def _draw_even(seed: int) -> Draw:
    rng = random.Random(seed ^ 0xD2A3)
    line = line_of_areas(rng.choice((1, 1, 2, 2, 3)), objects=rng.random() < 0.7)
    trains = tuple(range(1, rng.randint(2, 6) + 1))
    arbiters = tuple(range(FIRST_ARBITER, FIRST_ARBITER + rng.choice((1, 1, 3))))
    timers = TIMERS_A if rng.random() < 0.8 else TIMERS_B
    spread_m = (line.end_m - 300.0) / len(trains)
    fronts_m = {
        train: 150.0 + spread_m * index + rng.uniform(0.0, max(0.0, spread_m - 120.0))
        for index, train in enumerate(trains)
    }
    setting = Setting(
        fronts_m,
        stops_m=[area.start_m + at_m for area in line.areas for at_m in (500.0, 1500.0)],
        dwell_s=rng.choice((5.0, 20.0)),
    )
    config = T2tConfig(timers=timers, arbiters=arbiters)
    rng.random()
    turn_ms = rng.choice((1, 5, 10, 10))
    leisurely = rng.random() < 0.8
    return Draw(LineParticipants(line, config, trains), setting, turn_ms, leisurely)


def _draw_any(seed: int, profile: Profile) -> Draw:
    rng = random.Random(seed ^ 0xD2A4)
    dense = profile.dense
    span = DENSE if dense else WIDE
    line = line_by_chance(rng, span)
    length_m = rng.choice(span.trains_m)
    room_m = length_m + 40.0
    trains = tuple(range(1, min(rng.randint(*span.trains), int(line.end_m / room_m) - 1) + 1))
    arbiters = tuple(range(FIRST_ARBITER, FIRST_ARBITER + rng.choice((1, 1, 3))))
    timers = TIMERS_A if rng.random() < 0.8 else TIMERS_B
    setting = Setting(
        _fronts_m(rng, trains, room_m, line.end_m),
        stops_m=sorted(rng.uniform(0.1, 0.98) * line.end_m for _ in range(rng.randint(0, 6))),
        dwell_s=rng.choice((2.0, 5.0, 20.0)),
        length_m=length_m,
        speed_max_mps=rng.choice((30.0, 60.0, 60.0, 90.0)) / 3.6,
    )
    if profile.sidings:
        shorter = {train: _shorter(rng, length_m) for train in trains if rng.random() < 0.5}
        setting = replace(setting, builds=shorter)
    return Draw(
        LineParticipants(line, T2tConfig(timers=timers, arbiters=arbiters), trains),
        setting,
        turn_ms=rng.choice((1, 5, 10, 10)),
        leisurely=rng.random() < 0.8,
        between_s=rng.choice(span.between_s),
        ordered=profile.ordered,
        choosy=profile.choosy,
        sidings=profile.sidings,
        by_hand=profile.by_hand,
        disturbed=profile.disturbed and (not dense or rng.random() < 0.3),
        faults_s=(0.7, 15.0) if dense else FAULTS_S,
        foul_share=rng.choice((0.0, 0.0, 0.1, 0.3)) if dense else 0.0,
    )


def _shorter(rng: random.Random, length_m: float) -> Build:
    return Build(max(20.0, rng.uniform(0.25, 1.0) * length_m), rng.choice((4, 8, 12, 16, 24)))


def _fronts_m(
    rng: random.Random, trains: Sequence[int], room_m: float, end_m: float
) -> dict[int, float]:
    """Return random places of the train fronts, with free track between the trains."""
    spare_m = sorted(rng.uniform(0.0, end_m - room_m * len(trains)) for _ in trains)
    return {
        train: spare_m[index] + room_m * (index + 1) - 20.0 for index, train in enumerate(trains)
    }
