"""`hil resume`: continues a campaign that was stopped in any way."""

import argparse

from metro_hil.cli.hil.working import add_work_options, work_on


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "resume",
        help="continue a campaign",
        description="Continue a campaign that was stopped. Cases with a result are not run again, "
        "unless a power cut or a full disk damaged the result.",
    )
    parser.add_argument(
        "name",
        nargs="?",
        metavar="NAME",
        help="campaign, its folder, the beginning of that name, or a path; default: the last one",
    )
    parser.add_argument(
        "--despite-change",
        action="store_true",
        help="continue although the program was changed; such a campaign never counts as passed",
    )
    add_work_options(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Exit code as for `hil run`."""
    from metro_hil.engine.errors import UsageError
    from metro_hil.engine.folder import find_folder
    from metro_hil.engine.program import program_version

    folder = find_folder(options.name)
    manifest = folder.manifest()
    if manifest.program != program_version() and not options.despite_change:
        raise UsageError(
            f"{folder.path}: was begun with version {manifest.program} of the program, this is "
            f"{program_version()}; run it again, or give --despite-change"
        )
    if options.on is None:
        options.on = manifest.options.get("on")
    options.fail_fast = options.fail_fast or manifest.options.get("fail_fast", False)
    options.no_report = options.no_report or manifest.options.get("no_report", False)
    return work_on(folder, options, manifest.options)
