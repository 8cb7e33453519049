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
    """It ran, but it ended before a monitor could judge, or a measure could not be taken."""
    VACUOUS = "vacuous"
    """It ran to its end and shows nothing of what its file claims: the premise of a monitor never
    held, a fault touched nothing, or nothing was watched."""
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


class ExpectedFailure(msgspec.Struct, frozen=True, kw_only=True):
    """One monitor that a scenario expects to fail, with the range of its margin."""

    monitor: str
    """Name of the monitor or invariant."""
    margin_min: float | None = None
    """Least margin that is still the failure that is meant, in the monitor's unit."""
    margin_max: float | None = None


class Allowance(msgspec.Struct, frozen=True, kw_only=True):
    """Parts of a case that may show nothing, and why."""

    names: tuple[str, ...]
    """Monitors, kinds of faults, requirements, or one of the groups below."""
    reason: str


ANY_FAULT: Final = "faults"
ANY_REQUIREMENT: Final = "requirements"
WHOLE_CASE: Final = "case"
ALLOWANCE_GROUPS: Final = (ANY_FAULT, ANY_REQUIREMENT, WHOLE_CASE)
"""Every fault, every requirement named on the scenario, and the case as a whole."""


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
    expected: tuple[ExpectedFailure, ...] = ()
    """The monitors that fail, all of them and no other; empty for a case that passes."""
    vacuous: tuple[Allowance, ...] = ()
    """What of it may show nothing."""
    stop_at_violation: bool = True
    idle_counts: bool = False
    """Whether a train that never moved is evidence."""


class MonitorResult(msgspec.Struct, frozen=True, kw_only=True):
    """What one monitor says."""

    name: str
    verdict: Verdict
    """PASS, FAIL, INCONCLUSIVE or VACUOUS."""
    margin: float | None
    """Least distance to violation, negative when violated; None when nothing was seen."""
    unit: str
    at_s: float | None = None
    """Of the least margin."""
    detail: str = ""
    requirements: tuple[str, ...] = ()
    asked: bool = True
    """The file asks for it by name. An invariant that is watched by default may see nothing."""
    own: bool = True
    """It stands under `[[monitor]]`, so it judges the requirements named on the scenario."""


class FaultResult(msgspec.Struct, frozen=True, kw_only=True):
    """What one fault of a case did."""

    kind: str
    began: bool
    touched: int | None
    """Frames, telegrams, messages, cycles or values that it changed; None where nobody counts."""


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
    """Why it is not a pass, or which part of it may show nothing and why."""
    lacking: tuple[str, ...] = ()
    """What keeps it from being evidence, whatever the monitors found."""
    died: str = ""
    """How the controller ended by itself; empty when it did not."""
    exit_reason: str = ""
    """How the run ended."""
    sim_s: float = 0.0
    frames: int = 0
    chain: str = ""
    """Hash over all frames of the run in bus order, with their instants; hexadecimal."""
    monitors: tuple[MonitorResult, ...] = ()
    faults: tuple[FaultResult, ...] = ()
    """In the order of the case."""
    measures: dict[str, float | None] = {}
    """By name; the unit is the last part of the name."""
    events: tuple[CaseEvent, ...] = ()
    host: Host = Host()

    def least_margin(self) -> MonitorResult | None:
        """Of the monitor that was violated most, or came nearest to it, relative to none other."""
        known = [result for result in self.monitors if result.margin is not None]
        return min(known, key=lambda result: result.margin or 0.0, default=None)


def as_expected(case: Case, result: CaseResult) -> bool:
    """Whether the result is the one that the case's file claims."""
    return not mismatch(case, result)


def mismatch(case: Case, result: CaseResult) -> str:
    """Why the result is not the expected one; empty when it is.

    A case that expects a failure is as expected only when exactly the named monitors failed, each
    within its range, while the controller lived and nothing else was missing.
    """
    if not case.expected:
        # A vacuous case that lacks nothing is one that may show nothing, by its file.
        good = result.verdict in (Verdict.PASS, Verdict.VACUOUS) and not result.lacking
        return "" if good else result.reason or f"{result.verdict.value} instead of pass"
    named = {each.monitor: each for each in case.expected}
    meant = f"expected to fail by {', '.join(named)}"
    if result.verdict is not Verdict.FAIL:
        return f"{meant}, but {result.verdict.value}: {result.reason}".removesuffix(": ")
    if result.died:
        return f"{meant}, but {result.reason}"
    failed = {each.name: each for each in result.monitors if each.verdict is Verdict.FAIL}
    if others := [name for name in failed if name not in named]:
        return f"{meant}, but {', '.join(others)} failed too: {result.reason}"
    for name, each in named.items():
        if name not in failed:
            return f"{meant}, but {name} did not fail: {result.reason}"
        if not _within(each, failed[name].margin):
            return f"{meant} with a margin of {_range_text(each)}: {result.reason}"
    return f"{meant}, but {'; '.join(result.lacking)}" if result.lacking else ""


def _within(expected: ExpectedFailure, margin: float | None) -> bool:
    low, high = expected.margin_min, expected.margin_max
    if margin is None:
        return low is None and high is None
    return (low is None or margin >= low) and (high is None or margin <= high)


def _range_text(expected: ExpectedFailure) -> str:
    low, high = expected.margin_min, expected.margin_max
    ends = [f"{low:g} or more" if low is not None else ""]
    ends.append(f"{high:g} or less" if high is not None else "")
    return " and ".join(filter(None, ends))


def expected_text(case: Case) -> str:
    """What the case is expected to come to, in a few words."""
    if not case.expected:
        return Verdict.PASS.value
    return f"{Verdict.FAIL.value} by {', '.join(each.monitor for each in case.expected)}"


def fault_text(fault: FaultResult) -> str:
    """What one fault did, such as `frame_drop: touched 40`."""
    if not fault.began:
        return f"{fault.kind}: never began"
    if fault.touched is None:
        return f"{fault.kind}: began; what it touched is not known"
    return f"{fault.kind}: touched {fault.touched or 'nothing'}"


def subset_text(chosen: int, planned: int) -> str:
    """Such as `3 of 8 cases`; empty where all cases of a campaign were chosen."""
    return f"{chosen} of {planned} cases" if chosen < planned else ""
