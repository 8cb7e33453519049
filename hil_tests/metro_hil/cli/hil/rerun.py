"""`hil rerun`: repeats one case exactly, or with another seed, with all logs and a plot."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from metro_hil.cli.hil.working import number
from metro_hil.model.run_options import EXIT_FAILED, EXIT_OK
from metro_hil.model.terminal import console_for

if TYPE_CHECKING:
    from metro_hil.engine.folder import CampaignFolder
    from metro_hil.model.case import Case, CaseResult
    from metro_hil.model.run_folder import RunFolder


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "rerun",
        help="repeat one case with all logs",
        description="Repeat one case exactly, or with another seed, with all logs and a plot in a "
        "new run folder, and show its event log.",
    )
    parser.add_argument(
        "campaign_run",
        metavar="RUN",
        nargs="?",
        help="folder of a campaign, its beginning, or folder/case; default: the last campaign",
    )
    parser.add_argument(
        "case",
        nargs="?",
        metavar="CASE",
        help="id, its beginning, or number; default: the first unexpected one, or the one "
        "with the least margin",
    )
    parser.add_argument("--seed", type=number(0), metavar="N", help="default: the seed of the case")
    parser.add_argument("--out", metavar="DIR", help="default: a new folder below runs/")
    parser.add_argument("--no-plot", action="store_true", help="draw no plot")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--runner", help=argparse.SUPPRESS)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Exit code 0 if the case is as expected and, with its own seed, gave the same result."""
    import msgspec

    from canlog.run_names import mark_latest
    from firmware_py.clock.clock import WallClock
    from firmware_py.storage.whole_file import write_whole
    from metro_hil.engine.event_log import tell
    from metro_hil.engine.folder import folder_name
    from metro_hil.model.case import as_expected
    from metro_hil.model.run_folder import make_run_folder

    folder, case, before = find_case(options.campaign_run, options.case)
    if options.seed is not None and options.seed != case.seed:
        case, before = msgspec.structs.replace(case, seed=options.seed), None
    words = folder_name(case.id.replace("/", "_"))
    place = make_run_folder(options.out, WallClock().epoch_ns(), words)
    mark_latest(place.path)
    remembered = folder.manifest().options.get("runner")
    result = repeat(case, folder.files(), place, options.runner or remembered)
    text = msgspec.json.format(msgspec.json.encode(result), indent=2)
    write_whole(place.results, text + b"\n")
    drawn = not options.no_plot and draw(case, folder.files(), place)
    difference = difference_of(case, before, result)
    if options.json:
        print(_json(case, result, place, difference))
    else:
        tell(console_for(), case, result, sorted(place.path.iterdir()))
        print(f"plot: {place.plot if drawn else 'none'}")
        print(f"run folder: {place.path}")
    if difference:
        print(f"hil: {difference}", file=sys.stderr)
    return EXIT_OK if as_expected(case, result) and not difference else EXIT_FAILED


def find_case(
    name: str | None, wanted: str | None
) -> "tuple[CampaignFolder, Case, CaseResult | None]":
    """Find a case and its result, if it has one. Raises UsageError."""
    from metro_hil.engine.choosing import pick_case
    from metro_hil.engine.errors import UsageError
    from metro_hil.engine.folder import find_folder
    from metro_hil.engine.journal import once_each, read_journal

    try:
        folder = find_folder(name)
    except UsageError:
        # Reports name a case as campaign/id in one word; the id may hold slashes itself.
        if name is None or wanted is not None or "/" not in name:
            raise
        folder, wanted = _split(name)
    cases = folder.cases()
    by_id = once_each(read_journal(folder.journal_path).results)
    case = default_case(cases, by_id) if wanted is None else pick_case(cases, wanted)
    return folder, case, by_id.get(case.id)


def _split(name: str) -> "tuple[CampaignFolder, str]":
    from metro_hil.engine.errors import UsageError
    from metro_hil.engine.folder import find_folder

    parts = name.split("/")
    for place in range(len(parts) - 1, 0, -1):
        try:
            return find_folder("/".join(parts[:place])), "/".join(parts[place:])
        except UsageError:
            continue
    raise UsageError(f"{name}: no campaign begins like this")


def default_case(cases: "tuple[Case, ...]", by_id: "dict[str, CaseResult]") -> "Case":
    """The first unexpected case; else the one with the least margin; else the first."""
    from metro_hil.model.case import as_expected

    margins = []
    for case in cases:
        result = by_id.get(case.id)
        if result is None:
            continue
        if not as_expected(case, result):
            return case
        least = result.least_margin()
        if least is not None and least.margin is not None:
            margins.append((least.margin, case.index))
    return cases[min(margins)[1]] if margins else cases[0]


def repeat(
    case: "Case", files: dict[str, Path], place: "RunFolder", runner: str | None
) -> "CaseResult":
    import importlib

    from metro_hil.engine.worker import RUNNER

    module, _, function = (runner or RUNNER).partition(":")
    result: CaseResult = getattr(importlib.import_module(module), function)(
        case, files=files, folder=place
    )
    return result


def difference_of(case: "Case", before: "CaseResult | None", now: "CaseResult") -> str:
    """Error text if a case in virtual time gave two different results; empty otherwise."""
    from metro_hil.engine.journal import same_result
    from metro_hil.model.case import BenchKind, Verdict

    if before is None or case.bench is not BenchKind.LOCKSTEP or before.verdict is Verdict.LOST:
        return ""
    if before.chain != now.chain:
        return f"NOT DETERMINISTIC: chain {before.chain} in the campaign, {now.chain} now"
    return "" if same_result(before, now) else "NOT DETERMINISTIC: same frames, different judgement"


def draw(case: "Case", files: dict[str, Path], place: "RunFolder") -> bool:
    """Draw the plot of the run; False if there is nothing to draw."""
    from metro_hil.metrics.stops import measure_stops
    from metro_hil.model.case_setup import parts_of
    from metro_hil.model.log_columns import read_columns
    from metro_hil.report.campaign.plots import draw_run_of
    from metro_hil.report.plot import draw_run

    if not place.cycle_log.exists():
        return False
    draw_run_of(case, files, place)
    cycles = read_columns(place.cycle_log)
    truth = read_columns(place.truth_log) if place.truth_log.exists() else None
    journey = parts_of(case, files).journey
    stops = measure_stops(truth or cycles, journey.stops)
    return draw_run(place.plot, case.id, journey.line, cycles, truth, stops)


def _json(case: "Case", result: "CaseResult", place: "RunFolder", difference: str) -> str:
    import msgspec

    document = {
        "case": case,
        "result": result,
        "folder": str(place.path),
        "logs": [str(path) for path in sorted(place.path.iterdir())],
        "difference": difference,
    }
    return msgspec.json.encode(document).decode()
