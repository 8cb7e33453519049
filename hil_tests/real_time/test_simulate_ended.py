"""`hil simulate` on several processes, ended by a person, by the system, or by a kill."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil_tests.real_time.process_rig import children, until_gone

WORKERS = 2
LIMIT_S = 60.0
SIMULATE = (
    *(sys.executable, "-m", "metro_hil.cli.hil", "simulate", "--seeds", "1..100000"),
    *("--workers", str(WORKERS), "--minutes", "0.1"),
)


class Simulation:
    """The command in its own session, as a terminal starts it."""

    def __init__(self, journal: Path) -> None:
        self.journal = journal
        self.process = subprocess.Popen(
            [*SIMULATE, "--journal", str(journal)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def seeds(self) -> list[int]:
        """The seeds in the journal."""
        if not self.journal.exists():
            return []
        lines = self.journal.read_text(encoding="utf-8").splitlines(keepends=True)
        return [json.loads(line)["seed"] for line in lines if line.endswith("\n")]

    def until_it_runs(self) -> list[int]:
        """The workers, once the journal has enough seeds."""
        end_s = time.monotonic() + LIMIT_S
        while len(self.seeds()) < 2 * WORKERS:
            assert self.process.poll() is None
            assert time.monotonic() < end_s
            time.sleep(0.05)
        # One more process manages what they share.
        workers = children(self.process.pid)
        assert len(workers) == WORKERS + 1
        return workers


@pytest.fixture
def simulation(tmp_path: Path) -> Iterator[Simulation]:
    started = Simulation(tmp_path / "journal.jsonl")
    yield started
    if started.process.poll() is None:
        os.killpg(started.process.pid, signal.SIGKILL)
    started.process.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_ended_simulation_reports_its_runs_and_how_to_resume(
    simulation: Simulation, number: signal.Signals
) -> None:
    workers = simulation.until_it_runs()

    # Ctrl-C reaches all processes of a terminal, including the workers.
    os.killpg(simulation.process.pid, number)
    out, err = simulation.process.communicate(timeout=LIMIT_S)

    assert simulation.process.returncode == 130
    seeds = simulation.seeds()
    assert out.startswith(f"{len(seeds)} seeds: ")
    assert out.endswith("nothing broken\n")
    goes_on = f"the same command goes on from {simulation.journal}"
    assert err == f"hil: interrupted, this is what was run until then; {goes_on}\n"
    assert len(set(seeds)) == len(seeds)
    assert until_gone(workers) == []


def test_the_workers_end_with_a_killed_simulation(simulation: Simulation) -> None:
    workers = simulation.until_it_runs()

    simulation.process.kill()

    assert until_gone(workers) == []
