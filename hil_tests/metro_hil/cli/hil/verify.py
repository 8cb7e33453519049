"""`hil verify`: checks whether cases of a campaign give the same bits again."""

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from metro_hil.cli.hil.working import PROCESSES_MAX, number
from metro_hil.model.run_options import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_OK

if TYPE_CHECKING:
    from metro_hil.model.case import Case
    from metro_hil.replay.verify import Mismatch, VerifyResult

SAMPLE = 20


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "verify",
        help="run a sample of a campaign again and require the same bytes",
        description="Run a random sample of a campaign's cases in virtual time again: in other "
        "processes, in another order, beside busy ones, with another PYTHONHASHSEED. Exit code 0 "
        "when every result and every frame is the same, 1 when one is not.",
    )
    parser.add_argument(
        "name",
        nargs="?",
        metavar="NAME",
        help="campaign, its folder, the beginning of that name, or a path; default: the last one",
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--sample", type=number(1), default=SAMPLE, metavar="N", help=f"default: {SAMPLE}"
    )
    which.add_argument("--all", action="store_true", help="run every case")
    parser.add_argument("--seed", type=number(0), default=1, help="seed of the sample; default: 1")
    parser.add_argument(
        "--workers",
        type=number(1, PROCESSES_MAX),
        default=2,
        metavar="N",
        help="number of processes; default: 2",
    )
    parser.add_argument(
        "--load",
        type=number(0, PROCESSES_MAX),
        default=2,
        metavar="N",
        help="number of busy processes that load the machine; default: 2",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Exit code 1 if a case gave another result."""
    import msgspec

    from metro_hil.engine.folder import find_folder
    from metro_hil.replay.verify import verify

    def told(case: "Case") -> None:
        print(f"ran again: {case.id}", file=sys.stderr)

    result = verify(
        find_folder(options.name),
        sample=None if options.all else options.sample,
        seed=options.seed,
        workers=options.workers,
        load=options.load,
        told=told if sys.stderr.isatty() else None,
    )
    if options.json:
        table = {**msgspec.to_builtins(result), "identical": result.identical}
        print(msgspec.json.encode(table).decode())
    else:
        print("\n".join(lines(result)))
    if result.interrupted:
        print("hil: interrupted; this is what was compared until then", file=sys.stderr)
        return EXIT_INTERRUPTED
    return EXIT_OK if result.identical else EXIT_FAILED


def lines(result: "VerifyResult") -> Sequence[str]:
    """The result as lines of text for a person."""
    text = [f"{result.campaign}: {result.sampled} of {result.of} cases run again"]
    text += [f"note: {note}" for note in result.notes]
    if result.identical:
        return [*text, f"identical: every result, and all {result.frames} frames"]
    for mismatch in result.mismatches:
        text += _mismatch(mismatch)
    return [*text, f"different: {len(result.mismatches)} of {result.sampled}"]


def _mismatch(mismatch: "Mismatch") -> list[str]:
    text = [mismatch.case_id, *(f"  {words}" for words in mismatch.differences)]
    first = mismatch.first_frame
    if first is None:
        return [*text, f"  {mismatch.compared}"] if mismatch.compared else text
    return [
        *text,
        f"  {mismatch.compared} differ first at line {first.number} of bus.log:",
        f"    {first.one or 'ended'}",
        f"    {first.other or 'ended'}",
    ]
