"""`python -m metro_hil.watch FOLDER PID [MAY ...]`: the page of a run, for its command.

It ends with the process PID. `desk` gives the page the desk of the train, `faults` its faults,
`commands` the commands of supervision.
"""

import asyncio
import sys
import webbrowser
from pathlib import Path

from canlog.damage import LogError
from canlog.live.options import can_show
from canlog.live.page import serve_folder
from canlog.live.server import TokenServer
from canlog.views.serving import LOOPBACK
from firmware_py.assertions import require_assertions
from firmware_py.clock.realtime import die_with_parent
from firmware_py.settings import SettingsError
from metro_hil.watch.desk_keys import DeskKeys
from metro_hil.watch.fault_acts import open_fault_acts
from metro_hil.watch.line_folder import is_line_run, serve_line_folder
from plant_emulator.cli.names import DESK, FAULTS


def main() -> int:
    """Print the address first; the run waits for that line."""
    require_assertions("vobc")
    path, parent, *may = sys.argv[1:]
    folder = Path(path)
    die_with_parent(int(parent))
    try:
        server: TokenServer
        if is_line_run(folder):
            server = serve_line_folder(folder, host=LOOPBACK, commands="commands" in may)
        else:
            hands = DeskKeys(folder) if DESK in may else None
            faults = open_fault_acts(folder) if FAULTS in may else None
            server = serve_folder(folder, hands=hands, faults=faults, host=LOOPBACK, port=0)
    except (LogError, SettingsError) as error:
        print(f"page: none: {error}", flush=True)
        return 1
    print(f"page: {server.address}", flush=True)
    if can_show():
        webbrowser.open(server.address)
    asyncio.run(server.run())
    return 0


if __name__ == "__main__":
    sys.exit(main())
