"""Case, result and verdict: the values of a campaign, stored and sent as JSON."""

import enum
from typing import Any, Final

import msgspec

ConfigTable = dict[str, Any]
"""A table of TOML or JSON as Python reads it."""


class Verdict(enum.Enum):
    """Outcome of one case. Only `PASS` says that the case showed what its file claims."""

    PASS = "pass"  # noqa: S105
    FAIL = "fail"
    BLOCKED = "blocked"
    """A prerequisite of the case was missing: a fault that never began, a bench that is not there,
    a controller that did not start."""
    INCONCLUSIVE = "inconclusive"
    """The run ended before a monitor could judge, or before a measure could be taken."""
    VACUOUS = "vacuous"
    """The run reached its end but shows nothing of what its file claims. The premise of a monitor
    never held, a fault touched nothing, or no monitor watched."""
    INVALID = "invalid"
    """The host disturbed a run in real time, so its outcome does not depend on the controller
    alone."""
    LOST = "lost"
    """No attempt gave a result."""


class BenchKind(enum.Enum):
    LOCKSTEP = "lockstep"
    """Virtual time, all in one process."""
    PROCESSES = "processes"
    """Real time: processes on vcan or the embedded bus, real radio, real pty."""
    HARDWARE = "hardware"
    """A real CAN interface and serial line."""


TIME_MAX_S: Final = 3600.0
"""Maximum of each time in a timetable, s."""


class Setup(msgspec.Struct, frozen=True, kw_only=True):
    """One train on one line. A value of None means that of the files."""

    line: str = "florence"
    start: str | None = None
    end: str | None = None
    consist: str = "florence4"
    """Name of the consist file, which describes the real train."""
    params: str = "florence4"
    """Name of the parameter file, which says what the controller believes about the train."""
    load_ratio: float | None = None
    odometer_error: float | None = None
    cycle_ms: float = 50.0
    duration_s: float = 1800.0
    """Maximum virtual duration of the case, s; a train that has not arrived by then has failed to
    arrive."""
    desk_mode: str = "auto"
    driver: str | None = None
    """Driver model at the desk: `obedient`, `reckless` or `late`; None for no driver."""
    desk_recording: str | None = None
    """Desk recording to play back; a file of the user."""
    wakes_up: bool = False
    """Whether the controller was switched off at `start` and remembers its place; otherwise it was
    set up there. The remembered place counts once the detector of cold movement confirms it."""
    memory_line: str | None = None
    """Line that the remembered place belongs to; None for the line of the run."""
    stops: tuple[str, ...] | None = None
    """Stations to stop at, in running order; None for all between start and end."""
    dwell_s: dict[str, float] = {}
    """Dwell times by station, s; at other stations the line's file applies."""
    run_s: dict[str, float] = {}
    """Planned running times to stations from the one before, s; for others the line's file
    applies."""
    service: str | None = None
    """Service whose trips the train makes; a file of the user. `line` is that of the first trip."""
    trains: int | None = None
    """Number of trains that make the trips; None for that of the service."""
    masters: bool = False
    """Whether the trains of the service command themselves."""
    cut_master_at_s: float | None = None
    """Time at which the radio of a train that commands is cut, s; None for no cut."""
    kill_master_at_s: float | None = None
    """Time at which the controller of a train that commands is killed, s; None for none."""
    supply: str | None = None
    """Supply network that feeds these trains; None for a source of each."""
    real: ConfigTable = {}
    """Overrides of the consist's file by dotted key, such as `brake.service.gain_ratio.low`."""
    believed: ConfigTable = {}
    """Overrides of the controller's parameters by dotted key."""


class ControllerSpec(msgspec.Struct, frozen=True, kw_only=True):
    """The controller under test."""

    kind: str = "shipped"
    """`shipped`, `checkout` (another version, by `path`) or `command` (any program)."""
    path: str = ""
    command: str = ""
    """Command line, run without a shell; the bench fills in {bus}, {tags}, {radio}, {line},
    {params}, {start}, {end}, {out} and {grant}."""
    lease_s: float = 5.0
    """Wall time that an external program may take for each answer on the lockstep bench; beyond it,
    the program counts as hanging."""


class PlantSpec(msgspec.Struct, frozen=True, kw_only=True):
    """The plant that answers the controller."""

    kind: str = "shipped"
    """`shipped`, `command` (any program), `fmu` (a co-simulation FMU) or `nodes` (the shipped plant
    and LS-BUS nodes beside it)."""
    command: str = ""
    """Command line of the program, run without a shell."""
    mapping: str = ""
    """Path of the FMU's mapping file."""
    nodes: str = ""
    """Path of the file of LS-BUS nodes."""
    lease_s: float = 5.0
    """Wall time that the program may take for each answer; beyond it, it counts as hanging."""


class WireNames(msgspec.Struct, frozen=True, kw_only=True):
    """Wires of the benches in real time, as the user names them; see `metro_hil.realtime.wires`."""

    bus_a: str = "auto"
    """Bus segment of the controller, such as `socketcan:can0`."""
    bus_b: str = "auto"
    """Bus segment of the train, for cases with bus faults."""
    tags: str = "auto"
    """Serial line of the tag reader, such as `/dev/ttyUSB0`."""
    radio: str = "auto"
    """Address on which the wayside listens, such as `tcp/192.168.10.1:7447`."""
    plant: str = "auto"
    """Who provides the plant: `auto`, `ours` or `elsewhere`."""
    controller: str = "auto"


class Branch(msgspec.Struct, frozen=True, kw_only=True):
    """Point up to which all cases of a group are equal, so that this part runs only once.

    Random values up to the branch come from `seed`, later ones from the seed of the case.
    """

    seed: int
    when: str
    """Expression over the plant's true values; the branch is the first step at which it holds."""


class ExpectedFailure(msgspec.Struct, frozen=True, kw_only=True):
    """One monitor that a scenario expects to fail, with the range of its margin."""

    monitor: str
    """Name of the monitor or invariant."""
    margin_min: float | None = None
    """Least margin that still counts as the expected failure, in the monitor's unit."""
    margin_max: float | None = None


class Allowance(msgspec.Struct, frozen=True, kw_only=True):
    """Parts of a case that may show nothing, with the reason."""

    names: tuple[str, ...]
    """Names of monitors, fault kinds or requirements, or one of the groups below."""
    reason: str


ANY_FAULT: Final = "faults"
ANY_REQUIREMENT: Final = "requirements"
WHOLE_CASE: Final = "case"
ALLOWANCE_GROUPS: Final = (ANY_FAULT, ANY_REQUIREMENT, WHOLE_CASE)
"""Group names: every fault, every requirement of the scenario, and the case as a whole."""


class Case(msgspec.Struct, frozen=True, kw_only=True):
    """One run, completely described: in virtual time, the same case gives the same bytes
    anywhere."""

    id: str
    """Unique in its campaign, and stable: the same campaign file gives the same ids."""
    index: int
    """Number from 0, without gaps, in the order of the campaign."""
    scenario: str
    seed: int
    setup: Setup
    faults: tuple[ConfigTable, ...] = ()
    """Faults as in the scenario file, with the values of this case; see `read_faults`."""
    monitors: tuple[ConfigTable, ...] = ()
    """Monitors as in the scenario file; see `read_monitors`."""
    invariants: str | tuple[str, ...] = "all"
    """Invariants to judge beside the monitors: `all`, `none`, or names."""
    factors: dict[str, Any] = {}
    """Values that the sweep sets for this case, by swept key."""
    requirements: tuple[str, ...] = ()
    bench: BenchKind = BenchKind.LOCKSTEP
    controller: ControllerSpec = ControllerSpec()
    plant: PlantSpec = PlantSpec()
    wires: WireNames = WireNames()
    branch: Branch | None = None
    expected: tuple[ExpectedFailure, ...] = ()
    """Monitors that must fail, and no others; empty for a case that must pass."""
    vacuous: tuple[Allowance, ...] = ()
    """Parts of the case that may show nothing."""
    stop_at_violation: bool = True
    idle_counts: bool = False
    """Whether a run counts as evidence even if the train never moves."""


class MonitorResult(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one monitor."""

    name: str
    verdict: Verdict
    """PASS, FAIL, INCONCLUSIVE or VACUOUS."""
    margin: float | None
    """Least distance to violation, negative if violated; None if the monitor judged nothing."""
    unit: str
    at_s: float | None = None
    """Time of the least margin, s."""
    detail: str = ""
    requirements: tuple[str, ...] = ()
    asked: bool = True
    """Whether the file names the monitor. A default invariant may be vacuous without harm."""
    own: bool = True
    """Whether it stands under `[[monitor]]`; then it judges the requirements of the scenario."""


class FaultResult(msgspec.Struct, frozen=True, kw_only=True):
    """Effect of one fault of a case."""

    kind: str
    began: bool
    touched: int | None
    """Number of frames, telegrams, messages, cycles or values that the fault changed; None if not
    counted."""


class CaseEvent(msgspec.Struct, frozen=True):
    """An event for the event log of a run."""

    at_s: float
    what: str


class Host(msgspec.Struct, frozen=True, kw_only=True):
    """How the host served the run. It differs each time, so no report depends on it."""

    wall_s: float = 0.0
    """Wall time of the whole case, s."""
    stepping_s: float = 0.0
    """Part of `wall_s` that the run itself took, s."""
    processor_s: float = 0.0
    """Processor time of the case and its processes, s; 0 if not measured."""
    steal_s: float | None = None
    lateness_us_p99: float | None = None
    worker: str = ""
    attempts: int = 1


class CaseResult(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one case. On the lockstep bench, all but `host` depends only on the case."""

    case_id: str
    index: int
    verdict: Verdict
    reason: str = ""
    """Why the case is no pass, or which part of it may show nothing and why."""
    lacking: tuple[str, ...] = ()
    """Reasons why the case is no evidence, independent of the monitors."""
    died: str = ""
    """How the controller ended by itself; empty if it did not."""
    exit_reason: str = ""
    """How the run ended."""
    sim_s: float = 0.0
    frames: int = 0
    chain: str = ""
    """Hash over all frames of the run in bus order with their times, in hexadecimal."""
    monitors: tuple[MonitorResult, ...] = ()
    faults: tuple[FaultResult, ...] = ()
    """Effect of each fault, in the order of the case."""
    measures: dict[str, float | None] = {}
    """Measured values by name; the unit is the last part of the name."""
    events: tuple[CaseEvent, ...] = ()
    host: Host = Host()

    def least_margin(self) -> MonitorResult | None:
        """Result of the monitor with the least margin; the margins are compared as numbers,
        whatever their units."""
        known = [result for result in self.monitors if result.margin is not None]
        return min(known, key=lambda result: result.margin or 0.0, default=None)


def as_expected(case: Case, result: CaseResult) -> bool:
    """Whether the result is the one that the case's file claims."""
    return not mismatch(case, result)


def mismatch(case: Case, result: CaseResult) -> str:
    """Why the result is not the expected one; empty if it is.

    A case with expected failures needs exactly the named monitors to fail, each within its range.
    The controller must live on, and no other evidence may be missing.
    """
    if not case.expected:
        # The file allows such a vacuous case to show nothing.
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
    """Short text of the expected outcome."""
    if not case.expected:
        return Verdict.PASS.value
    return f"{Verdict.FAIL.value} by {', '.join(each.monitor for each in case.expected)}"


def fault_text(fault: FaultResult) -> str:
    """Text of the effect of one fault, such as `frame_drop: touched 40`."""
    if not fault.began:
        return f"{fault.kind}: never began"
    if fault.touched is None:
        return f"{fault.kind}: began; what it touched is not known"
    return f"{fault.kind}: touched {fault.touched or 'nothing'}"


def plant_text(plant: PlantSpec) -> str:
    """Text such as `with plant command ./train`; empty for the shipped plant."""
    if plant == PlantSpec():
        return ""
    return f"with plant {plant.kind} {plant.command or plant.mapping or plant.nodes}"


def subset_text(chosen: int, planned: int) -> str:
    """Text such as `3 of 8 cases`; empty where all cases of a campaign were selected."""
    return f"{chosen} of {planned} cases" if chosen < planned else ""
