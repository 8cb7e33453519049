"""`hil scenarios`: lists the shipped scenarios, which can be run by name."""

import argparse

from metro_hil.model.run_options import EXIT_OK


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "scenarios",
        help="list the shipped scenarios, which can be run by name",
        description="List the scenarios of all shipped campaigns. `hil run NAME` runs one of them, "
        "`hil run CAMPAIGN` all of a campaign.",
    )
    parser.add_argument("words", nargs="*", metavar="WORD", help="list only those that contain it")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Raises UsageError if no scenario contains all the words."""
    import msgspec
    from rich.markup import escape
    from rich.table import Table

    from metro_hil.campaign.scenarios import shipped_scenarios
    from metro_hil.engine.errors import UsageError
    from metro_hil.model.terminal import console_for

    wanted = [word.lower() for word in options.words]
    found = [
        each
        for each in shipped_scenarios()
        if all(
            word in " ".join((each.name, each.campaign, each.title, *each.requirements)).lower()
            for word in wanted
        )
    ]
    if not found:
        asked = " ".join(options.words)
        raise UsageError(f"{asked}: no shipped scenario has it; `hil scenarios` lists all")
    if options.json:
        print(msgspec.json.encode({"scenarios": found}).decode())
        return EXIT_OK
    table = Table()
    for column in ("scenario", "campaign", "what", "requirements"):
        table.add_column(column, overflow="fold")
    for each in found:
        words = (each.name, each.campaign, each.title, ", ".join(each.requirements))
        table.add_row(*map(escape, words))
    console_for().print(table)
    return EXIT_OK
