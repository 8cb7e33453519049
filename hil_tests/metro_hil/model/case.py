"""The nouns of a campaign: case, result, verdict. Plain values that travel as JSON."""

import enum
from typing import Any, Final

import msgspec

ConfigTable = dict[str, Any]
"""A table as TOML and JSON know it."""


class Verdict(enum.Enum):
    """What became of one case. Only `PASS` says that it was shown to work."""

    PASS = "pass"  # noqa: S105
    FAIL = "fail"
    BLOCKED = "blocked"
    """What the case needs did not come about: a fault that never began, a bench that is not there,
    a controller that did not start."""
    INCONCLUSIVE = "inconclusive"
    """It ran, but a monitor never saw what it judges."""
    INVALID = "invalid"
    """The host disturbed a run in real time, so that its outcome says nothing of the controller."""
    LOST = "lost"
    """No result came back, however often it was tried."""


class BenchKind(enum.Enum):
    LOCKSTEP = "lockstep"
    """Virtual time, all in one process."""
    PROCESSES = "processes"
    """Real time: processes on vcan or the embedded bus, real radio, real pty."""
    HARDWARE = "hardware"
    """A real CAN interface and serial line."""


TIME_MAX_S: Final = 3600.0
"""Bound on each time of a timetable."""


class Setup(msgspec.Struct, frozen=True, kw_only=True):
    """One train on one line. None takes what the files say."""

    line: str = "florence"
    start: str | None = None
    end: str | None = None
    consist: str = "florence4"
    """What the train really is."""
    params: str = "florence4"
    """What the controller believes of it."""
    load_ratio: float | None = None
    odometer_error: float | None = None
    cycle_ms: float = 50.0
    duration_s: float = 1800.0
    """The case ends after this at the latest; a train still on its way then has not arrived."""
    desk_mode: str = "auto"
    driver: str | None = None
    """A model of a driver at the desk: `obedient`, `reckless` or `late`; None for nobody."""
    desk_recording: str | None = None
    """A recording of a desk that is played; a file of the user's."""
    wakes_up: bool = False
    """The controller was switched off at `start` and remembers it; else the train was set up there.
    What it remembers counts once the detector of cold movement bears it out."""
    stops: tuple[str, ...] | None = None
    """Stations to stop at, in running order; None for all between start and end."""
    dwell_s: dict[str, float] = {}
    """By station; others dwell as the line's file says."""
    run_s: dict[str, float] = {}
    """Planned running times to stations, from the one before; others as the line's file says."""
    real: ConfigTable = {}
    """Overrides of the consist's file by dotted key, such as `brake.service.gain_ratio.low`."""
    believed: ConfigTable = {}
    """Overrides of the controller's parameters by dotted key."""


class ControllerSpec(msgspec.Struct, frozen=True, kw_only=True):
    """What is under test."""

    kind: str = "shipped"
    """`shipped`, `checkout` (another version, by `path`) or `command` (any program)."""
    path: str = ""
    command: str = ""
    """Started through no shell; {bus}, {tags}, {radio}, {line}, {params}, {start}, {end}, {out} and
    {grant} are filled in."""
    lease_s: float = 5.0
    """On the lockstep bench a program of its own has so much wall time for each answer; one that
    takes longer hangs."""


class WireNames(msgspec.Struct, frozen=True, kw_only=True):
    """What the benches in real time use, as the user names it; see `metro_hil.realtime.wires`."""

    bus_a: str = "auto"
    """The controller's segment, such as `socketcan:can0`."""
    bus_b: str = "auto"
    """The train's segment, for cases with faults of the bus."""
    tags: str = "auto"
    """Serial line of the tag reader, such as `/dev/ttyUSB0`."""
    radio: str = "auto"
    """Where the wayside listens, such as `tcp/192.168.10.1:7447`."""
    plant: str = "auto"
    """Who brings it along: `auto`, `ours` or `elsewhere`."""
    controller: str = "auto"


class Branch(msgspec.Struct, frozen=True, kw_only=True):
    """All cases of a group are the same up to here, so that this part is run once.

    Up to the branch the run is drawn from `seed`; from then on from the seed of the case.
    """

    seed: int
    when: str
    """Expression over the plant's truth; the branch is the first step at which it holds."""


class Case(msgspec.Struct, frozen=True, kw_only=True):
    """One run, completely described: the same case gives the same bytes anywhere."""

    id: str
    """Unique in its campaign and stable: the same campaign file gives the same ids."""
    index: int
    """From 0, without gaps, in the order of the campaign."""
    scenario: str
    seed: int
    setup: Setup
    faults: tuple[ConfigTable, ...] = ()
    """As in the scenario file, with the values of this case; see `read_faults`."""
    monitors: tuple[ConfigTable, ...] = ()
    """As in the scenario file; see `read_monitors`."""
    invariants: str | tuple[str, ...] = "all"
    """`all`, `none`, or names; they are judged beside the monitors."""
    factors: dict[str, Any] = {}
    """What the sweep chose for this case, by swept key."""
    requirements: tuple[str, ...] = ()
    bench: BenchKind = BenchKind.LOCKSTEP
    controller: ControllerSpec = ControllerSpec()
    wires: WireNames = WireNames()
    branch: Branch | None = None
    expected: Verdict = Verdict.PASS
    stop_at_violation: bool = True
    idle_counts: bool = False
    """Whether monitors alone decide, though the train never moved or a fault never began."""


class MonitorResult(msgspec.Struct, frozen=True, kw_only=True):
    """What one monitor says."""

    name: str
    verdict: Verdict
    """PASS, FAIL or INCONCLUSIVE."""
    margin: float | None
    """Least distance to violation, negative when violated; None when nothing was seen."""
    unit: str
    at_s: float | None = None
    """Of the least margin."""
    detail: str = ""
    requirements: tuple[str, ...] = ()


class CaseEvent(msgspec.Struct, frozen=True):
    """Something that happened, for the story of a run."""

    at_s: float
    what: str


class Host(msgspec.Struct, frozen=True, kw_only=True):
    """How the host served the run. Not part of what a report is made of: it differs every time."""

    wall_s: float = 0.0
    """Of the whole case."""
    stepping_s: float = 0.0
    """Of that, spent in the run itself."""
    processor_s: float = 0.0
    """Processor time of the whole case, its processes included; 0: not measured."""
    steal_s: float | None = None
    lateness_us_p99: float | None = None
    worker: str = ""
    attempts: int = 1


class CaseResult(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one case. All but `host` is a function of the case on the lockstep bench."""

    case_id: str
    index: int
    verdict: Verdict
    reason: str = ""
    """Why it is not a pass, in words."""
    exit_reason: str = ""
    """How the run ended."""
    sim_s: float = 0.0
    frames: int = 0
    chain: str = ""
    """Hash over all frames of the run in bus order, with their instants; hexadecimal."""
    monitors: tuple[MonitorResult, ...] = ()
    measures: dict[str, float | None] = {}
    """By name; the unit is the last part of the name."""
    events: tuple[CaseEvent, ...] = ()
    host: Host = Host()

    def least_margin(self) -> MonitorResult | None:
        """Of the monitor that was violated most, or came nearest to it, relative to none other."""
        known = [result for result in self.monitors if result.margin is not None]
        return min(known, key=lambda result: result.margin or 0.0, default=None)


def as_expected(case: Case, result: CaseResult) -> bool:
    return result.verdict is case.expected
