"""`hil serve`: shows all campaigns of a folder in a browser, with their history."""

import argparse
from pathlib import Path

from canlog.live.options import add_serving
from metro_hil.model.run_options import EXIT_OK


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "serve",
        help="show all campaigns of a folder in a browser, with their history",
        description="Show all campaigns of a folder in a browser: their history, two of them "
        "compared, the progress of a running one, and the page of each case whose logs were kept. "
        "Folders of other machines may be copied into it. Ctrl-C ends.",
    )
    parser.add_argument(
        "folder",
        nargs="?",
        type=Path,
        metavar="FOLDER",
        help="folder with campaigns, at most two levels below; default: runs/hil",
    )
    add_serving(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Serve until the user interrupts."""
    import asyncio
    import webbrowser

    from canlog.damage import LogError
    from canlog.live.options import can_show, warn_of
    from firmware_py.clock.clock import WallClock
    from metro_hil.engine.errors import UsageError
    from metro_hil.engine.folder import ROOT
    from metro_hil.watch.campaign_server import CampaignServer

    root: Path = options.folder or ROOT
    if not root.is_dir():
        raise UsageError(f"{root}: no such folder; `hil run` makes campaigns below {ROOT}")
    try:
        server = CampaignServer(
            root, now_ns=WallClock().epoch_ns, host=options.listen, port=options.port
        )
    except LogError as error:
        raise UsageError(str(error)) from error
    warn_of(options.listen, "hil")
    print(f"campaigns: {server.address} (Ctrl-C ends)", flush=True)
    if not options.no_browser and can_show():
        webbrowser.open(server.address)
    asyncio.run(server.run())
    return EXIT_OK
