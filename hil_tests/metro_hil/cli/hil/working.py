"""What `hil run` and `hil resume` share: options, the work itself, and the closing lines."""

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Any, Final

from firmware_py.arguments import of_file
from metro_hil.engine.errors import EngineError, UsageError
from metro_hil.model.run_options import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_OK
from metro_hil.model.terminal import console_for

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console

    from metro_hil.engine.folder import CampaignFolder, Manifest
    from metro_hil.engine.run_campaign import CampaignEnd
    from metro_hil.engine.worker_pool import WorkerPool
    from metro_hil.model.case import Case, CaseResult
    from metro_hil.report.campaign import CampaignInfo

KEEP: Final = 10
KEEP_WORST: Final = 3
KEEP_WORST_ALONE: Final = 12
"""Logs kept when one scenario runs alone: its user wants to look at them."""
UNEXPECTED_SHOWN_MAX: Final = 10
PROCESSES_MAX: Final = 1024
"""Maximum number of processes; no machine on which this runs can use more."""


def number(least: int, most: int | None = None) -> Callable[[str], int]:
    """Parser of a whole number within the limits."""

    def whole(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
        if value < least:
            raise argparse.ArgumentTypeError(f"{text} is less than {least}")
        if most is not None and value > most:
            raise argparse.ArgumentTypeError(f"{text} is more than {most}")
        return value

    return whole


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds") from None
    if not 0.0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"{text} is not more than 0 s")
    return value


def add_work_options(parser: argparse.ArgumentParser) -> None:
    """Add the options about how cases are run, not which."""
    parser.add_argument("--on", metavar="dask://HOST:PORT", help="default: this machine")
    parser.add_argument(
        "--workers",
        type=number(1, PROCESSES_MAX),
        metavar="N",
        help="default: one for each processor",
    )
    parser.add_argument(
        "--nice", type=number(0), default=0, metavar="N", help="niceness of local workers"
    )
    parser.add_argument(
        "--keep",
        type=number(0),
        metavar="N",
        help=f"keep the logs of the first N cases that are not as expected; default: {KEEP}",
    )
    parser.add_argument(
        "--keep-worst",
        type=number(0),
        metavar="N",
        help=f"also keep those of the N least margins; default: {KEEP_WORST}, for one "
        f"scenario alone {KEEP_WORST_ALONE}",
    )
    parser.add_argument(
        "--case-timeout",
        type=_seconds,
        metavar="S",
        help="wall time for one case; default: 120, in real time plus twice its duration",
    )
    parser.add_argument(
        "--fail-fast", action="store_true", help="stop at the first case that is not as expected"
    )
    parser.add_argument("--no-report", action="store_true", help="write no report at the end")
    parser.add_argument(
        "--json", action="store_true", help="one JSON object on standard output, all else on stderr"
    )
    # Tests of the engine replace the bench by this option.
    parser.add_argument("--runner", help=argparse.SUPPRESS)


def kept_options(options: argparse.Namespace) -> dict[str, Any]:
    """Options that the manifest keeps for `hil resume` and for readers."""
    names = (
        *("campaign", "on", "bench", "controller", "filter", "seed", "limit", "keep"),
        "keep_worst",
        *("case_timeout", "fail_fast", "no_report", "runner"),
    )
    return {name: value for name in names if (value := getattr(options, name, None)) is not None}


def refuse_unknown_layout(campaign: str, layout: str | None) -> None:
    """Raises UsageError for a layout that does not exist."""
    from firmware_py.settings import nearest
    from metro_hil.report.layouts import LAYOUTS

    if layout is not None and layout not in LAYOUTS:
        hint = nearest(layout, sorted(LAYOUTS), "layout")
        raise UsageError(f"{campaign}: layout: {layout!r}: {hint}")


def check_on(on: str | None, benches: Sequence[str]) -> None:
    """Raises UsageError for an invalid cluster address, or for cases that need this machine."""
    from metro_hil.model.case import BenchKind

    if on is None:
        return
    if not on.startswith("dask://") or not on.removeprefix("dask://"):
        raise UsageError(f"--on {on}: not dask://HOST:PORT")
    if set(benches) != {BenchKind.LOCKSTEP.value}:
        raise UsageError(f"--on {on}: only for the bench lockstep; others need this machine")


def work_on(
    folder: "CampaignFolder", options: argparse.Namespace, remembered: dict[str, Any]
) -> int:
    """Run the remaining cases, report, print the outcome. Options not given are as remembered."""
    try:
        return _work_on(folder, options, remembered)
    except (EngineError, OSError) as error:
        what = of_file(error) if isinstance(error, OSError) else error
        raise EngineError(f"{what}; nothing is lost: hil resume {folder.path}") from error
    except KeyboardInterrupt as error:
        by = error.args[0] if error.args else "Ctrl-C"
        raise KeyboardInterrupt(f"{by}; nothing is lost: hil resume {folder.path}") from error


def _work_on(
    folder: "CampaignFolder", options: argparse.Namespace, remembered: dict[str, Any]
) -> int:
    from metro_hil.engine.progress import ProgressDisplay
    from metro_hil.engine.run_campaign import CampaignOptions, run_campaign
    from metro_hil.engine.stopping import StopWish

    console = console_for(json=options.json)
    alone = len({case.scenario for case in folder.cases()}) == 1
    worst = KEEP_WORST_ALONE if alone else KEEP_WORST
    for name, default in (("keep", KEEP), ("keep_worst", worst), ("case_timeout", None),
                          ("runner", None)):  # fmt: skip
        if getattr(options, name) is None:
            setattr(options, name, remembered.get(name, default))
    wishes = CampaignOptions(
        keep=options.keep,
        keep_worst=options.keep_worst,
        always=() if options.no_report else wanted_logs(folder),
        fail_fast=options.fail_fast,
    )
    benches = [case.bench.value for case in folder.cases()]
    with crews(folder, options, benches) as (crew, keeper), StopWish() as stop:
        end = run_campaign(folder, crew, keeper, ProgressDisplay(console), stop, wishes)
    reports: Sequence[Path] = ()
    try:
        # An interrupted campaign gets reports, too; a second Ctrl-C skips them.
        if not options.no_report and stop.count <= 1:
            reports = _report(console, folder, end)
    finally:
        say_end(console, folder, end, reports)
        if options.json:
            print(end_json(folder, end, reports))
    return exit_code(end)


def _report(console: "Console", folder: "CampaignFolder", end: "CampaignEnd") -> "Sequence[Path]":
    from metro_hil.cli.hil.verdicts import tell_scenario
    from metro_hil.report.campaign.plots import draw_kept

    plots = draw_kept(folder, end.cases)
    reports = write_reports(folder, folder.manifest(), end)
    tell_scenario(console, end.cases, end.results, plots)
    return reports


def wanted_logs(folder: "CampaignFolder") -> Sequence[str]:
    """Ids of the cases from which the campaign's layout draws its figures."""
    from metro_hil.report.layouts import LAYOUTS

    layout = LAYOUTS.get(folder.manifest().layout or "")
    return () if layout is None else layout.wants(folder.cases())


@contextmanager
def crews(
    folder: "CampaignFolder", options: argparse.Namespace, benches: Sequence[str]
) -> Iterator[tuple[Callable[[], "WorkerPool"], Callable[[], "WorkerPool"]]]:
    """Makers of two pools: one runs the cases, one repeats some on this machine to keep logs.

    One fork server forks the workers of both; it ends with the block.
    """
    from metro_hil.engine.local_pool import LocalPool, PoolServer
    from metro_hil.engine.worker import RUNNER

    check_on(options.on, benches)
    files, runner = folder.files(), options.runner or RUNNER
    server = PoolServer(runner, options.nice)

    def local() -> "WorkerPool":
        return LocalPool(
            options.workers or processors(),
            files,
            case_timeout_s=options.case_timeout,
            server=server,
        )

    def cluster() -> "WorkerPool":
        from metro_hil.engine.dask_pool import DaskPool

        address = options.on.removeprefix("dask://")
        return DaskPool(address, files, runner=runner, case_timeout_s=options.case_timeout)

    with closing(server):
        yield (local if options.on is None else cluster), local


def processors() -> int:
    """Number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def write_reports(
    folder: "CampaignFolder", manifest: "Manifest", end: "CampaignEnd"
) -> "Sequence[Path]":
    from metro_hil.report import campaign

    info = info_of(manifest, end.cases)
    return campaign.write_reports(folder.path, info, end.cases, end.results)


def info_of(manifest: "Manifest", cases: "Sequence[Case]") -> "CampaignInfo":
    """Head of a campaign's report."""
    from metro_hil.model.case import plant_text
    from metro_hil.report.campaign import CampaignInfo

    benches = dict.fromkeys(
        " ".join(filter(None, (case.bench.value, plant_text(case.plant)))) for case in cases
    )
    devices = dict.fromkeys(
        " ".join(filter(None, (device.kind, device.path, device.command)))
        for device in (case.controller for case in cases)
    )
    return CampaignInfo(
        name=manifest.name,
        title=manifest.title,
        description=manifest.description,
        bench=", ".join(benches),
        controller=", ".join(devices),
        fingerprint=manifest.fingerprint,
        versions={**manifest.versions, "program": manifest.program},
        expected_cases=manifest.cases,
        planned_cases=manifest.planned_cases,
        layout=manifest.layout,
    )


def exit_code(end: "CampaignEnd") -> int:
    if end.interrupted:
        return EXIT_INTERRUPTED
    return EXIT_OK if end.totals.passed else EXIT_FAILED


def speed_text(results: "Sequence[CaseResult]") -> str:
    """Simulated time beside processor time; empty if no case has both, as in older journals."""
    measured = [result for result in results if result.sim_s > 0.0 < result.host.processor_s]
    if not measured:
        return ""
    sim_s = sum(result.sim_s for result in measured)
    processor_s = sum(result.host.processor_s for result in measured)
    speed = sim_s / processor_s
    return f"{sim_s:.0f} s simulated in {processor_s:.1f} s of processors: {speed:.0f} times"


def say_end(
    console: "Console", folder: "CampaignFolder", end: "CampaignEnd", reports: "Sequence[Path]"
) -> None:
    from metro_hil.cli.hil.verdicts import again, seeds_words
    from metro_hil.engine.totals import counts_words

    totals = end.totals
    print_layout(console, folder.manifest().layout, end.cases, end.results)

    def say(words: str, style: str = "") -> None:
        console.print(words, style=style, markup=False, highlight=False, soft_wrap=True)

    for problem in totals.problems:
        say(problem, "bold red")
    for name in totals.unexpected[:UNEXPECTED_SHOWN_MAX]:
        say(f"not as expected: {name}; again: {again(name, folder.path)}", "red")
    if (more := len(totals.unexpected) - UNEXPECTED_SHOWN_MAX) > 0:
        say(f"not as expected: {more} more", "red")
    if totals.missing:
        say(f"without a result: {len(totals.missing)} of {totals.cases}", "magenta")
    counts = counts_words(totals.counts, len(totals.missing))
    for words in seeds_words(end.cases):
        say(words)
    say(f"{totals.done} of {totals.cases} cases: {counts}")
    if text := speed_text(end.results):
        say(text)
    for path in reports:
        say(f"report: {path}")
    say(f"campaign folder: {folder.path}")
    if end.interrupted:
        say(f"stopped; nothing is lost: hil resume {folder.path}", "yellow")
    else:
        subset = folder.manifest().subset
        stamp = f" (subset: {subset})" if subset else ""
        state = "passed: every case is as expected" if totals.passed else "FAILED"
        say(f"{state}{stamp}", "green" if totals.passed else "bold red")


def print_layout(
    console: "Console",
    layout: str | None,
    cases: "Sequence[Case]",
    results: "Sequence[CaseResult]",
) -> None:
    """Print the campaign's own table, if it has one."""
    if layout is None:
        return
    from metro_hil.report.layouts import show_layout

    by_id = {result.case_id: result for result in results}
    show_layout(console, layout, [(case, by_id.get(case.id)) for case in cases])


def end_json(folder: "CampaignFolder", end: "CampaignEnd", reports: "Sequence[Path]") -> str:
    import msgspec

    manifest = folder.manifest()
    document = {
        "name": manifest.name,
        "folder": str(folder.path),
        "fingerprint": manifest.fingerprint,
        "interrupted": end.interrupted,
        "subset": manifest.subset or None,
        **msgspec.to_builtins(end.totals),
        "sim_s": sum(result.sim_s for result in end.results),
        "reports": [str(path) for path in reports],
    }
    return msgspec.json.encode(document).decode()
