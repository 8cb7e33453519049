"""A run that needs a bus joins one that the user brought up, and never that of another run."""

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from rich.console import Console

from firmware_py.buses.hub_control import start_hub
from metro_hil.cli.realtime_run import RealtimeRun
from metro_hil.model.mission import plan_journey
from metro_hil.model.run_folder import RunFolder
from metro_hil.model.run_options import parse


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    # The name of a socket must be short.
    with tempfile.TemporaryDirectory(prefix="bus") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        # A vcan0 of the kernel would be shared.
        monkeypatch.setattr("firmware_py.buses.look_up", lambda name: None)
        yield


@pytest.mark.parametrize(("bound", "name"), [(True, "vcan0-2"), (False, "vcan0")])
@pytest.mark.usefixtures("runtime")
def test_only_a_bus_that_no_run_started_for_itself_is_shared(
    bound: bool, name: str, tmp_path: Path
) -> None:
    options = parse(["run"])
    console = Console(file=(tmp_path / "said").open("w"))
    run = RealtimeRun(
        *(options, plan_journey(options), RunFolder(tmp_path), console), check_train=lambda: None
    )
    with ExitStack() as stack:
        first = start_hub("vcan0", bound=bound)
        stack.callback(first.stop)

        assert run._choose_bus(stack) == f"embedded:{name}"
