"""`hil run`: runs all cases of a campaign."""

import argparse
from typing import TYPE_CHECKING, Any

from metro_hil.cli.hil.working import (
    add_work_options,
    check_on,
    kept_options,
    number,
    refuse_unknown_layout,
    work_on,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from metro_hil.engine.folder import CampaignPlan

LINE_WORDS = """\
`hil run line` is not a campaign but a whole line of trains that command themselves, in processes or
in virtual time. It has options of its own, such as --trains 8, --for 60, --kill-master-at 20 and
--secure FOLDER; `hil line --help` has them all.
"""
BENCHES = ("lockstep", "processes", "hardware")
GREEN = "green-cbtc"
BOARD = "lines"
AUTO = "auto"
PRESENCES = (AUTO, "ours", "elsewhere")


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "run",
        help="run a campaign, or one scenario by its name",
        description="Run all cases of a campaign. Ctrl-C, and even kill -9, lose nothing: "
        "`hil resume` continues.",
        epilog=LINE_WORDS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("campaign", metavar="NAME", help="shipped campaign or scenario, or a file")
    parser.add_argument("--bench", choices=BENCHES, help="default: that of each scenario")
    parser.add_argument(
        "--controller",
        metavar="DEVICE",
        help="shipped, checkout:PATH or command:WORDS; default: that of each scenario",
    )
    parser.add_argument(
        "--filter", metavar="GLOB", help="only cases whose id matches, such as *-s7"
    )
    parser.add_argument(
        "--seed", type=number(0), metavar="N", help="use only this seed, instead of the scenario's"
    )
    parser.add_argument("--limit", type=number(1), metavar="N", help="only the first N cases")
    parser.add_argument(
        "--with",
        dest="folders",
        action="append",
        default=[],
        metavar="FOLDER",
        help="for `hil run lines`: also the lines and the train that `vobc import` wrote there",
    )
    parser.add_argument(
        "--complete",
        action="store_true",
        help="refuse to run less than the whole campaign; for continuous integration",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        help="default: a new folder below runs/hil, named by date and campaign",
    )
    add_work_options(parser)
    _add_wires(parser)
    parser.set_defaults(run=run)


def _add_wires(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "the wires, in real time", "`auto`, the default, leaves the choice to the bench."
    )
    group.add_argument(
        "--bus", default=AUTO, metavar="SPEC", help="bus of the controller, such as socketcan:can0"
    )
    group.add_argument(
        "--train-bus",
        default=AUTO,
        metavar="SPEC",
        help="bus of the train, behind the gateway that injects bus faults",
    )
    group.add_argument("--tags", default=AUTO, metavar="DEVICE", help="such as /dev/ttyUSB0")
    group.add_argument("--radio", default=AUTO, metavar="ENDPOINT", help="such as tcp/HOST:7447")
    group.add_argument(
        "--plant",
        default=AUTO,
        metavar="PLANT",
        help="who provides the plant: ours or elsewhere, in real time; or on every bench "
        "command:WORDS or fmu:MAPPING, a program or FMU that emulates parts of the train; or in "
        "virtual time nodes:FILE, LS-BUS nodes on the bus of the train",
    )
    group.add_argument(
        "--vobc",
        choices=PRESENCES,
        default=AUTO,
        help="who provides the controller: the bench, or it runs already",
    )


def run(options: argparse.Namespace) -> int:
    """Exit code 0 only if every case is as expected."""
    import sys

    if options.campaign == GREEN:
        # This simulates a whole line with point masses, without cases of the bench.
        from metro_hil.energy.line import command

        return command.run(options)
    from metro_hil.engine.folder import make_folder

    folder = make_folder(plan_of(options), options.out)
    print(f"campaign folder: {folder.path}", file=sys.stderr if options.json else sys.stdout)
    return work_on(folder, options, {})


def plan_of(options: argparse.Namespace) -> "CampaignPlan":
    """Select the cases and plan the folder. Raises SettingsError or UsageError."""
    from metro_hil.campaign import plan_cases
    from metro_hil.campaign.scenarios import read_named
    from metro_hil.engine.choosing import choose
    from metro_hil.engine.errors import UsageError
    from metro_hil.engine.folder import CampaignPlan
    from metro_hil.foreign_plant.choice import read_plant
    from metro_hil.model.case import WireNames, subset_text

    foreign = None if options.plant in PRESENCES else read_plant(options.plant)
    added = _added_lines(options.campaign, options.folders)
    campaign = read_named(options.campaign, options.seed, added)
    refuse_unknown_layout(options.campaign, campaign.layout)
    cases = choose(
        plan_cases(campaign),
        pattern=options.filter,
        limit=options.limit,
        bench=options.bench,
        controller=options.controller,
        plant=foreign,
        wires=WireNames(
            bus_a=options.bus,
            bus_b=options.train_bus,
            tags=options.tags,
            radio=options.radio,
            plant=options.plant if foreign is None else AUTO,
            controller=options.vobc,
        ),
    )
    check_on(options.on, [case.bench.value for case in cases])
    whole = campaign if options.seed is None else read_named(options.campaign, added=added)
    planned = sum(scenario.case_count for scenario in whole.scenarios)
    if options.complete and len(cases) < planned:
        raise UsageError(
            f"--complete: {subset_text(len(cases), planned)} are selected; leave out --filter, "
            "--limit and --seed"
        )
    return CampaignPlan(
        name=campaign.name,
        title=campaign.title,
        description=campaign.description,
        layout=campaign.layout,
        cases=cases,
        planned_cases=planned,
        files=campaign.files,
        options=kept_options(options),
    )


def _added_lines(campaign: str, folders: "Sequence[str]") -> "list[dict[str, Any]]":
    """Scenarios of the folders of imported lines. Raises SettingsError or UsageError."""
    from metro_hil.campaign.imported import imported_scenarios
    from metro_hil.engine.errors import UsageError

    if folders and campaign != BOARD:
        raise UsageError(f"--with {folders[0]}: only for `hil run {BOARD}`, not for {campaign}")
    return [scenario for folder in folders for scenario in imported_scenarios(folder)]
