"""Replaces console scripts of an environment by launchers that ask a warm server."""

import json
import os
import socket
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

from metro_hil.model.native_copy import SWITCH, Native, worker_environment
from metro_tools.warm import client
from metro_tools.warm.server import values_at_start

PROGRAMS: Final = ("canlog", "hil", "plant", "vobc")
REAL: Final = "programs"
"""Folder for the replaced scripts, beside the folder of the launchers."""
FROM_SOURCES: Final = (
    *("metro_hil.cli.vobc", "metro_hil.cli.hil.run", "metro_hil.cli.vobc_run"),
    *("metro_hil.engine.run_campaign", "metro_hil.engine.local_pool", "metro_hil.engine.progress"),
    *("metro_hil.campaign", "metro_hil.cli.hil.verdicts", "metro_hil.report.campaign.plots"),
    *("metro_hil.report.campaign.page.render", "metro_hil.report.campaign.parquet"),
    *("metro_hil.report.campaign.junit", "metro_hil.report.campaign.trace"),
    *("metro_hil.report.explain.command", "metro_hil.report.layouts", "pyarrow.parquet"),
    *("matplotlib.backends.backend_agg", "matplotlib.backends.backend_svg", "scipy.special"),
    *("scipy.optimize", "rich.console", "rich.table", "canlog.command", "plant_emulator.cli"),
)
"""Modules of the programs as they are."""
FROM_COPY: Final = (
    *("metro_hil.cli.vobc_run", "metro_hil.run.lockstep", "metro_hil.report.plot"),
    *("matplotlib.backends.backend_agg", "rich.table"),
)
"""Modules of `vobc run` in the compiled copy."""
LAUNCHER: Final = """#!{python} -IS
import sys
sys.path.append({folder!r})
from client import main
main({places!r}, [{program!r}, *sys.argv[1:]])
"""


@contextmanager
def warm_programs(
    venv: Path, environment: Mapping[str, str], copy: Path | None, sockets: Path
) -> Iterator[None]:
    """Make PROGRAMS of an environment start by a fork; the servers end with the block.

    Args:
        environment: variables of the programs.
        copy: packages of the compiled copy, in which `vobc run` works; None without one.
        sockets: folder whose path is short.
    """
    python = venv / "bin" / "python"
    values = values_at_start(environment)
    with ExitStack() as servers:
        places = {"": str(sockets / "warm")}
        servers.enter_context(_server(python, environment, values, FROM_SOURCES, sockets / "warm"))
        if copy is not None:
            places["run"] = str(sockets / "copy")
            inside = worker_environment({**environment, SWITCH: Native.WIRE.value}, copy)
            servers.enter_context(_server(python, inside, values, FROM_COPY, sockets / "copy"))
        real = venv / REAL
        real.mkdir()
        for name in PROGRAMS:
            script = venv / "bin" / name
            script.rename(real / name)
            script.write_text(
                LAUNCHER.format(
                    python=python,
                    folder=str(Path(client.__file__).parent),
                    places=places if name == "vobc" else {"": places[""]},
                    program=str(real / name),
                ),
                encoding="utf-8",
            )
            script.chmod(0o755)
        try:
            yield
        finally:
            for name in PROGRAMS:
                (real / name).replace(venv / "bin" / name)
            real.rmdir()


@contextmanager
def _server(
    python: Path,
    environment: Mapping[str, str],
    values: Mapping[str, str | None],
    modules: tuple[str, ...],
    place: Path,
) -> Iterator[None]:
    """A server with these modules that listens at a place."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening:
        listening.bind(str(place))
        listening.listen()
        server = subprocess.Popen(  # noqa: S603 - our own program
            [
                *(str(python), "-P", "-m", "metro_tools.warm.server"),
                *("--socket", str(listening.fileno()), "--values", json.dumps(values)),
                *modules,
            ],
            env=environment,
            pass_fds=[listening.fileno()],
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
    try:
        yield
    finally:
        os.killpg(server.pid, 9)
        server.wait()
        place.unlink()
