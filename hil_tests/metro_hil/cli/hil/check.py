"""`hil check`: checks a campaign file and shows what it would run."""

import argparse

from firmware_py.settings import SettingsError
from metro_hil.cli.hil.working import refuse_unknown_layout
from metro_hil.engine.errors import UsageError
from metro_hil.model.run_options import EXIT_OK

LISTED = 5


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "check",
        help="check a campaign file and show what it would run",
        description="Check a campaign file and show what it would run, without running it. All "
        "errors are reported at once, one line each.",
    )
    parser.add_argument(
        "campaign", metavar="CAMPAIGN", help="shipped campaign or scenario, or a file"
    )
    parser.add_argument("--cases", action="store_true", help="list the ids of all cases")
    parser.add_argument(
        "--list",
        type=_count,
        default=LISTED,
        metavar="N",
        help=f"list the ids of the first N cases; default: {LISTED}",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Raises SettingsError with all errors of the campaign."""
    import msgspec

    from metro_hil.campaign import CampaignError
    from metro_hil.campaign.scenarios import read_named
    from metro_hil.campaign.summary import lines, summarise
    from metro_hil.engine.folder import fingerprint_of

    try:
        campaign = read_named(options.campaign)
        refuse_unknown_layout(options.campaign, campaign.layout)
    except (SettingsError, UsageError) as error:
        problems = error.problems if isinstance(error, CampaignError) else (str(error),)
        if options.json:
            print(msgspec.json.encode({"problems": problems}).decode())
        raise
    summary, cases = summarise(campaign, None if options.cases else options.list)
    # The fingerprint that `hil run` stores, which includes the program's version.
    found = fingerprint_of(cases, campaign.files)
    summary = msgspec.structs.replace(summary, fingerprint=found)
    if options.json:
        print(msgspec.json.encode(summary).decode())
    else:
        print("\n".join(lines(summary)))
    return EXIT_OK


def _count(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} is less than 0")
    return value
