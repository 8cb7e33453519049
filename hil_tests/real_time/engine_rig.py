"""A campaign of invented cases on real worker processes, for tests of the engine."""

import atexit
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import msgspec

from metro_hil.engine.folder import CampaignFolder, CampaignPlan, make_folder
from metro_hil.engine.journal import without_host
from metro_hil.engine.local_pool import LocalPool, PoolServer
from metro_hil.engine.progress import Silent
from metro_hil.engine.run_campaign import CampaignEnd, CampaignOptions, run_campaign
from metro_hil.engine.stopping import StopWish
from metro_hil.engine.trial_runner import trial_cases
from metro_hil.engine.worker_pool import WorkerPool
from metro_hil.model.case import Case, CaseResult

RUNNER: Final = "metro_hil.engine.trial_runner:run_case"
SERVER: Final = PoolServer(RUNNER)
"""Forks the workers of all tests; a server of its own for each test would import all once more."""
atexit.register(SERVER.close)
NOTHING_KEPT: Final = CampaignOptions(keep=0, keep_worst=0)


class Listener(Silent):
    """Records the messages of a campaign."""

    def __init__(self) -> None:
        self.results: list[CaseResult] = []
        self.lost: list[tuple[str, int, str]] = []
        self.said: list[str] = []

    def result(self, case: Case, result: CaseResult) -> None:
        self.results.append(result)

    def lost_attempt(self, case_id: str, attempt: int, reason: str) -> None:
        self.lost.append((case_id, attempt, reason))

    def say(self, words: str) -> None:
        self.said.append(words)


def asking(cases: Sequence[Case], index: int, **asked: object) -> tuple[Case, ...]:
    """The same cases, one of which has instructions for its runner."""
    real = {f"trial.{key}": value for key, value in asked.items()}
    setup = msgspec.structs.replace(cases[index].setup, real=real)
    changed = list(cases)
    changed[index] = msgspec.structs.replace(cases[index], setup=setup)
    return tuple(changed)


def folder_of(cases: Sequence[Case], root: Path, **files: str) -> CampaignFolder:
    return make_folder(
        CampaignPlan(name="trial", cases=cases, files=files, options={"runner": RUNNER}), root=root
    )


def local(
    folder: CampaignFolder, workers: int = 2, timeout_s: float | None = None
) -> Callable[[], LocalPool]:
    return lambda: LocalPool(workers, folder.files(), case_timeout_s=timeout_s, server=SERVER)


def work(
    folder: CampaignFolder,
    make_crew: Callable[[], WorkerPool] | None = None,
    wishes: CampaignOptions = NOTHING_KEPT,
    listener: Silent | None = None,
    stop: StopWish | None = None,
) -> CampaignEnd:
    return run_campaign(
        folder,
        make_crew or local(folder),
        local(folder),
        listener or Silent(),
        stop or StopWish(),
        wishes,
    )


def plain(end: CampaignEnd) -> list[dict[str, object]]:
    """All results without the data that depend on the host."""
    return [without_host(result) for result in end.results]


__all__ = [
    "Listener",
    "NOTHING_KEPT",
    "RUNNER",
    "asking",
    "folder_of",
    "local",
    "plain",
    "trial_cases",
    "work",
]
