"""`hil from-run`: makes a scenario of a run that a person acted on at its page."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from metro_hil.engine.errors import EngineError, UsageError
from metro_hil.model.run_options import EXIT_FAILED, EXIT_OK
from metro_hil.model.terminal import console_for

if TYPE_CHECKING:
    from metro_hil.from_log.recorded_run import RecordedRun, Replayed


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "from-run",
        help="make a scenario of a run that a person acted on, and replay it",
        description="Make a scenario of the acts that a person did at the page of a run: desk and "
        "faults, at the instants of the run. Replay it in virtual time, and claim in it what the "
        "invariants showed. A run in virtual time must give the same frames again. Exit code 0 if "
        "the replay is as claimed, 1 if not.",
    )
    parser.add_argument(
        "recording",
        nargs="?",
        metavar="RUN",
        help="folder of a run or part of its name; default: the last run",
    )
    parser.add_argument("--out", metavar="DIR", help="default: a new folder below runs/")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Exit code 0 if the replay is as the scenario claims, with the frames of a lockstep run."""
    from canlog.damage import LogError
    from canlog.run_names import choose_run
    from firmware_py.arguments import of_file
    from firmware_py.clock.clock import WallClock
    from metro_hil.from_log.recorded_run import leave_replay, read_run
    from metro_hil.model.case import as_expected
    from metro_hil.model.run_folder import make_run_folder

    try:
        recorded = read_run(choose_run(options.recording, "hil from-run"))
    except LogError as error:
        raise UsageError(str(error)) from error
    words = f"from-run_{recorded.folder.resolve().name}"
    folder = make_run_folder(options.out, WallClock().epoch_ns(), words).path
    try:
        done = leave_replay(folder, recorded)
    except OSError as error:
        raise EngineError(of_file(error)) from error
    if options.json:
        print(_json(done))
    else:
        _tell(folder, recorded, done)
    return EXIT_OK if as_expected(done.case, done.result) and _same(done) else EXIT_FAILED


def _same(done: "Replayed") -> bool:
    """Whether the frames are those of the run, up to the end of the replay."""
    return done.differs_s is None or done.differs_s >= done.result.sim_s


def _tell(folder: Path, recorded: "RecordedRun", done: "Replayed") -> None:
    from metro_hil.cli.hil.verdicts import tell_scenario

    print(
        f"{recorded.folder}: {len(recorded.faults)} faults and {recorded.desk_changes} changes of "
        f"the desk in {recorded.end_s:g} s; it ended: {recorded.exit_reason}"
    )
    tell_scenario(console_for(), [done.case], [done.result], {})
    print(_frames_text(recorded, done))
    print(f"replayed: {folder / 'replayed'}")
    print(f"scenario: {done.path}")


def _frames_text(recorded: "RecordedRun", done: "Replayed") -> str:
    result = done.result
    if not recorded.options.lockstep:
        return "frames: not compared, because the run was in real time"
    if done.differs_s is None:
        return f"frames: all {result.frames} as in the run, frame hash {result.chain}"
    if _same(done):
        return (
            f"frames: as in the run until the replay ends at {result.sim_s:g} s "
            f"({result.exit_reason})"
        )
    return f"frames: other ones than in the run from {done.differs_s:g} s on"


def _json(done: "Replayed") -> str:
    import msgspec

    document = {
        "scenario": str(done.path),
        "same_frames": done.differs_s is None,
        "differs_s": done.differs_s,
        "result": done.result,
    }
    return msgspec.json.encode(document).decode()
