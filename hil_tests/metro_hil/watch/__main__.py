"""`python -m metro_hil.watch FOLDER PID [desk]`: the page of a run until the process PID ends."""

import asyncio
import sys
import webbrowser
from pathlib import Path

from canlog.damage import LogError
from canlog.live.options import can_show
from canlog.live.page import serve_folder
from canlog.views.serving import LOOPBACK
from firmware_py.assertions import require_assertions
from firmware_py.clock.realtime import die_with_parent
from metro_hil.watch.desk_keys import DeskKeys


def main() -> int:
    """Print the address first; the run waits for that line."""
    require_assertions("vobc")
    folder, parent, *desk = sys.argv[1:]
    die_with_parent(int(parent))
    try:
        hands = DeskKeys(Path(folder)) if desk else None
        server = serve_folder(Path(folder), hands=hands, host=LOOPBACK, port=0)
    except LogError as error:
        print(f"page: none: {error}", flush=True)
        return 1
    print(f"page: {server.address}", flush=True)
    if can_show():
        webbrowser.open(server.address)
    asyncio.run(server.run())
    return 0


if __name__ == "__main__":
    sys.exit(main())
