"""Makes a scenario of a run that a person acted on: desk and faults at the same instants."""

import json
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import msgspec
import tomli_w

from firmware_py import settings
from firmware_py.settings import SettingsError
from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb import load_line
from metro_hil.campaign import plan_cases, read_campaign
from metro_hil.from_log.scenario import AFTER_S, RECORDING, SCENARIO, copied
from metro_hil.model.case import Case, CaseResult, Verdict
from metro_hil.model.end_condition import ARRIVED
from metro_hil.model.log_columns import RunLogError, read_columns
from metro_hil.model.run_folder import RunFolder
from metro_hil.model.run_options import BROWSER
from metro_hil.model.verdict import EXERCISED, NEVER_MOVED, RunEvidence, judge
from metro_hil.monitors.catalogue import INVARIANTS
from metro_hil.run.dispatch import run_case
from plant_emulator.cli.by_hand import DESK_RECORDING, FAULT_RECORD
from plant_emulator.desk.recording import load_recording
from plant_emulator.faults.fault_file import load_faults
from plant_emulator.train_config import load_train
from plant_emulator.world import STEP_S

OPTIONS: Final = "options"
REPLAYED: Final = "replayed"
"""Folder of the replay."""
HEAD: Final = """\
# Made by `hil from-run` from {name}. `hil run {scenario}` replays it; see docs/guide/watch.md.
# invariants, expected and vacuous say what the replay in virtual time showed.

"""


@dataclass(frozen=True, slots=True)
class RecordedOptions:
    """The options of `vobc run` on which a replay depends."""

    line: str
    consist: str
    params: str
    seed: int
    cycle_ms: float
    lockstep: bool
    desk: str = "auto"
    start: str | None = None
    end: str | None = None
    load_ratio: float | None = None
    odometer_error: float | None = None
    driver: str | None = None
    desk_recording: str | None = None
    ato: str | None = None
    output: str | None = None


UNREPLAYED: Final[Mapping[str, str]] = {
    "train": "its train commanded itself, with others on the line",
    "trains": "it had several trains",
}
"""Options of runs that no scenario with one train can replay, with the reason."""


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """A run with the acts of a person."""

    folder: Path
    options: RecordedOptions
    exit_reason: str
    frame_log_sha256: str
    end_s: float
    """Time from the start of the train to the end of the run, s."""
    faults: Sequence[Mapping[str, Any]]
    desk_changes: int
    """Number of changes at a desk that a person operated."""


@dataclass(frozen=True, slots=True)
class Replayed:
    """The scenario and its replay in virtual time."""

    path: Path
    case: Case
    result: CaseResult
    differs_s: float | None
    """Time of the first frame that differs from the run, s; None if the frames are the same."""


def read_run(folder: Path) -> RecordedRun:
    """Read a run folder. Raises SettingsError that names file and key."""
    options = _options(folder)
    results = _results(folder)
    truth = folder / "truth.csv"
    if not truth.is_file():
        raise SettingsError(
            f"{truth}: missing; only a run whose train the bench emulated can be replayed"
        )
    record = folder / FAULT_RECORD
    tables = []
    if record.is_file():
        load_faults(str(record))
        tables = tomllib.loads(record.read_text(encoding="utf-8")).get("fault", [])
    changes = 0
    if options.desk == BROWSER:
        # The first line says how the desk was before the first act.
        changes = max(0, len(load_recording(str(folder / DESK_RECORDING)).changes) - 1)
    if not tables and not changes:
        raise SettingsError(
            f"{folder}: no acts by hand; a run with --allow-faults or --desk browser records them"
        )
    return RecordedRun(
        folder,
        options,
        results["exit_reason"],
        results["frame_log_sha256"],
        _end_s(truth),
        tables,
        changes,
    )


def _end_s(truth: Path) -> float:
    """Return the end of the run: one step after the last row of the truth log."""
    try:
        times_s = read_columns(truth).numbers("t_s")
    except RunLogError as error:
        raise SettingsError(str(error)) from error
    if not len(times_s):
        raise SettingsError(f"{truth}: no rows; the run is damaged")
    return round(float(times_s[-1]) + STEP_S, 3)


def _options(folder: Path) -> RecordedOptions:
    path = folder / "run.toml"
    table = settings.parse(path).get(OPTIONS)
    if not isinstance(table, dict):
        raise SettingsError(f"{path}: {OPTIONS}: missing; the run is damaged or of an old version")
    for name, why in UNREPLAYED.items():
        if name in table:
            raise SettingsError(f"{path}: {OPTIONS}.{name}: {why}, so no scenario can replay it")
    if table.get("plant", "auto") != "auto":
        raise SettingsError(f"{path}: {OPTIONS}.plant: the bench did not emulate the train")
    known = {each.name for each in fields(RecordedOptions)}
    used = {name: value for name, value in table.items() if name in known}
    try:
        options = settings.build(RecordedOptions, used, str(path), OPTIONS)
    except SettingsError as error:
        raise SettingsError(f"{error}; the run is damaged or of an old version") from error
    try:
        load_line(options.line)
        load_train(options.consist)
    except SettingsError as error:
        raise SettingsError(f"{path}: {OPTIONS}: {error}") from error
    if options.desk in ("external", "none"):
        raise SettingsError(
            f"{path}: {OPTIONS}.desk: {options.desk!r}: the run recorded no desk, so no scenario "
            "can replay it"
        )
    return options


def _results(folder: Path) -> Mapping[str, Any]:
    path = folder / "results.json"
    try:
        results = json.loads(path.read_text(encoding="utf-8"))
        if all(isinstance(results[name], str) for name in ("exit_reason", "frame_log_sha256")):
            return dict(results)
        why = "exit_reason, frame_log_sha256: no text"
    except FileNotFoundError:
        why = "missing; the run still goes on, or did not end in good order"
    except (OSError, ValueError, TypeError) as error:
        why = f"cannot be read: {error}"
    except KeyError as error:
        why = f"{error.args[0]}: missing; the run is damaged or of an old version"
    raise SettingsError(f"{path}: {why}")


def leave_replay(folder: Path, run: RecordedRun) -> Replayed:
    """Write the scenario, replay it in virtual time, and write what that showed into it.

    Raises SettingsError or OSError.
    """
    document = _document(folder, run)
    path = _write(folder, run, document)
    (folder / REPLAYED).mkdir()
    replay = RunFolder(folder / REPLAYED)
    result = _run(path, replay)
    path = _write(folder, run, document | _claims(result))
    (case,) = plan_cases(read_campaign(str(path)))
    result = _judged(case, result)
    differs_s = None
    if run.options.lockstep:
        differs_s = first_difference_s(run.folder / "bus.log", replay.bus_log)
    return Replayed(path, case, result, differs_s)


def _run(path: Path, folder: RunFolder) -> CaseResult:
    campaign = read_campaign(str(path))
    (case,) = plan_cases(campaign)
    files = {name: path.parent / name for name in campaign.files}
    return run_case(case, files=files, folder=folder)


def _judged(case: Case, result: CaseResult) -> CaseResult:
    """Judge a result by a case of the same run that claims something else."""
    monitors = tuple(each for each in result.monitors if each.verdict in EXERCISED)
    shown = RunEvidence(
        monitors=monitors,
        faults=result.faults,
        died=result.died,
        moved_m=0.0 if NEVER_MOVED in result.lacking else math.inf,
        violated=False,
    )
    judgement = judge(case, shown)
    return msgspec.structs.replace(
        result,
        verdict=judgement.verdict,
        reason=judgement.reason,
        lacking=judgement.lacking,
        monitors=monitors,
    )


def _document(folder: Path, run: RecordedRun) -> dict[str, Any]:
    options = run.options
    arrived = run.exit_reason == ARRIVED
    end_s = float(math.ceil(run.end_s) + AFTER_S) if arrived else run.end_s
    train: dict[str, Any] = {
        "line": copied(folder, "line", options.line),
        "consist": copied(folder, "consist", options.consist),
        "params": copied(folder, "params", options.params),
        "cycle_ms": options.cycle_ms,
        "duration_s": end_s,
    }
    names = ("start", "end", "load_ratio", "odometer_error", "driver")
    train |= {name: value for name in names if (value := getattr(options, name)) is not None}
    train["desk_mode"] = "manual" if options.desk == BROWSER else options.desk
    played = folder_of_desk(run)
    if played is not None:
        write_whole(folder / RECORDING, played.read_text(encoding="utf-8"))
        train["desk_recording"] = RECORDING
    believed = {"ato.strategy": options.ato, "ato.output.stage": options.output}
    if given := {key: value for key, value in believed.items() if value is not None}:
        train["believed"] = given
    document: dict[str, Any] = {
        "title": f"Run by hand: {run.folder.resolve().name}",
        "seeds": [options.seed],
        "stop_at_violation": False,
        "train": train,
        "fault": list(run.faults),
    }
    if arrived:
        document["monitor"] = [{"name": "arrives", "measure": "arrived_count", "min": 1.0}]
    return document


def folder_of_desk(run: RecordedRun) -> Path | None:
    """Return the recording that operates the desk in the replay; None without one."""
    if run.options.desk == BROWSER:
        return run.folder / DESK_RECORDING
    return None if run.options.desk_recording is None else Path(run.options.desk_recording)


def _claims(result: CaseResult) -> dict[str, Any]:
    """Return the keys that claim what the replay showed."""
    known = {each.name for each in INVARIANTS}
    own = [each for each in result.monitors if each.name in known]
    claims: dict[str, Any] = {
        "invariants": [each.name for each in own if each.verdict in EXERCISED]
    }
    if failed := [each.name for each in result.monitors if each.verdict is Verdict.FAIL]:
        claims["expected"] = {"fails": failed}
    if idle := sorted({each.kind for each in result.faults if not each.began or not each.touched}):
        claims["vacuous"] = {"allowed": idle, "reason": "changed nothing in the recorded run"}
    if NEVER_MOVED in result.lacking:
        claims["idle_counts"] = True
    return claims


def _write(folder: Path, run: RecordedRun, document: Mapping[str, Any]) -> Path:
    path = folder / SCENARIO
    tables = {name: each for name, each in document.items() if name in ("train", "fault")}
    rest = {name: each for name, each in document.items() if name not in tables}
    head = HEAD.format(name=run.folder.resolve().name, scenario=SCENARIO)
    write_whole(path, head + tomli_w.dumps({**rest, **tables}))
    return path


def first_difference_s(one: Path, other: Path) -> float | None:
    """Return the time of the first frame in which two logs differ; None if they are the same."""
    with one.open("rb") as first, other.open("rb") as second:
        while True:
            a, b = first.readline(), second.readline()
            if a != b:
                stamp = (b or a).partition(b")")[0].strip(b"( ")
                return float(stamp)
            if not a:
                return None
