"""Campaigns on real worker processes: deaths, hangs and stops of workers cost no result."""

import os
import signal
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import msgspec
import pytest

from firmware_py.clock.clock import WallClock
from hil_tests.real_time.engine_rig import (
    Listener,
    asking,
    folder_of,
    local,
    plain,
    trial_cases,
    work,
)
from metro_hil.engine.errors import EngineError
from metro_hil.engine.journal import Journal, read_journal
from metro_hil.engine.kill_trial import RUNNER, KillTrial, plan_of
from metro_hil.engine.local_pool import LocalPool, PoolServer
from metro_hil.engine.queue import Batch
from metro_hil.engine.run_campaign import CampaignOptions
from metro_hil.engine.stopping import StopWish
from metro_hil.engine.worker_pool import Outcome
from metro_hil.model.case import BenchKind, Branch, Case, CaseResult, Verdict

NS_PER_S = 1_000_000_000
WAIT_S = 30.0


class Interruptor(Listener):
    """Requests the end after a number of results."""

    def __init__(self, stop: StopWish, after: int, times: int = 1) -> None:
        super().__init__()
        self._stop, self._after, self._times = stop, after, times

    def result(self, case: Case, result: CaseResult) -> None:
        super().result(case, result)
        if len(self.results) == self._after:
            self._stop.count += self._times


def test_every_case_has_one_result_in_campaign_order(tmp_path: Path) -> None:
    folder = folder_of(trial_cases(40), tmp_path, line="a = 1")

    end = work(folder)

    assert end.totals.passed
    assert [result.index for result in end.results] == list(range(40))
    assert len(read_journal(folder.journal_path).results) == 40
    assert {result.host.attempts for result in end.results} == {1}
    assert all(result.host.processor_s > 0.0 for result in end.results)


def test_the_number_of_workers_changes_no_result(tmp_path: Path) -> None:
    one, three = (folder_of(trial_cases(30), tmp_path, line="a = 1") for _ in range(2))

    assert plain(work(one, local(one, 1))) == plain(work(three, local(three, 3)))


def test_a_complete_campaign_starts_no_worker(tmp_path: Path) -> None:
    folder = folder_of(trial_cases(3), tmp_path)
    first = work(folder)

    def no_pool() -> LocalPool:
        raise AssertionError("a worker was started")

    again = work(folder, no_pool)

    assert plain(again) == plain(first)
    assert again.totals == first.totals


@pytest.mark.parametrize("times", [1, 2])
def test_a_stopped_campaign_resumes_to_the_same_results(times: int, tmp_path: Path) -> None:
    """After one request running cases are finished. After two they are dropped and run again
    later."""
    whole = work(folder_of(trial_cases(40), tmp_path))
    folder, stop = folder_of(trial_cases(40), tmp_path), StopWish()

    broken_off = work(folder, listener=Interruptor(stop, 10, times), stop=stop)
    resumed = work(folder)

    assert broken_off.interrupted
    assert not broken_off.totals.passed
    assert 10 <= broken_off.totals.done < 40
    assert plain(resumed) == plain(whole)
    assert resumed.totals == whole.totals
    assert len(read_journal(folder.journal_path).results) == 40


def test_a_killed_worker_costs_no_result(tmp_path: Path) -> None:
    undisturbed = work(folder_of(trial_cases(12), tmp_path))
    cases = asking(trial_cases(12), 5, die_unless=str(tmp_path / "died"))
    folder, listener = folder_of(cases, tmp_path), Listener()

    end = work(folder, listener=listener)

    assert plain(end) == plain(undisturbed)
    assert [(name, attempt) for name, attempt, _ in listener.lost] == [(cases[5].id, 1)]
    assert "SIGKILL" in listener.lost[0][2]
    assert [result.host.attempts for result in end.results] == [*[1] * 5, 2, *[1] * 6]
    assert [one.case_id for one in read_journal(folder.journal_path).lost_attempts] == [cases[5].id]


def test_a_case_that_kills_every_worker_is_lost_and_the_rest_goes_on(tmp_path: Path) -> None:
    folder = folder_of(asking(trial_cases(6), 2, die_unless=""), tmp_path)

    end = work(folder)

    assert [result.verdict for result in end.results].count(Verdict.PASS) == 5
    assert end.results[2].verdict is Verdict.LOST
    assert "SIGKILL" in end.results[2].reason
    assert end.results[2].host.attempts == 3
    assert not end.totals.passed


def test_a_case_that_kills_every_worker_costs_no_other_case_of_its_group(tmp_path: Path) -> None:
    branch = Branch(seed=1, when="speed_mps > 1.0")
    cases = asking(trial_cases(8), 1, die_unless="")
    grouped = [msgspec.structs.replace(case, branch=branch) for case in cases]

    end = work(folder_of(grouped, tmp_path))

    verdicts = [result.verdict for result in end.results]
    assert verdicts == [Verdict.PASS, Verdict.LOST, *[Verdict.PASS] * 6]


def test_a_hanging_case_is_lost_after_its_timeout(tmp_path: Path) -> None:
    folder = folder_of(asking(trial_cases(3), 1, hang=True), tmp_path)

    end = work(folder, local(folder, timeout_s=0.5))

    assert [result.verdict.value for result in end.results] == ["pass", "lost", "pass"]
    assert "no result within 0.5 s" in end.results[1].reason


def test_a_case_that_raises_is_lost_and_its_traceback_kept(tmp_path: Path) -> None:
    folder = folder_of(asking(trial_cases(3), 1, **{"raise": "our mistake"}), tmp_path)

    end = work(folder)

    assert [result.verdict.value for result in end.results] == ["pass", "lost", "pass"]
    assert end.results[1].reason == "the bench raised RuntimeError: our mistake"
    kept = folder.kept(end.results[1].case_id).path / "traceback.txt"
    assert "our mistake" in kept.read_text()


def test_workers_that_cannot_start_end_the_campaign_with_their_last_output(tmp_path: Path) -> None:
    folder = folder_of(trial_cases(3), tmp_path)

    with pytest.raises(EngineError, match="no_such_runner"):
        work(folder, lambda: LocalPool(1, {}, runner="metro_hil.no_such_runner:run_case"))

    assert read_journal(folder.journal_path).results == []


def test_logs_are_kept_of_the_first_failures_and_the_least_margins(tmp_path: Path) -> None:
    cases = trial_cases(12)
    for index in (3, 5, 8):
        cases = asking(cases, index, verdict="fail")
    folder = folder_of(cases, tmp_path)

    end = work(folder, wishes=CampaignOptions(keep=2, keep_worst=2))

    kept = {result.index for result in end.results if folder.kept(result.case_id).results.exists()}
    margins = {one.index: one.monitors[0].margin or 0.0 for one in end.results}
    # The third failure has a negative margin, so it is the least one left.
    near = sorted(set(margins) - {3, 5}, key=lambda index: margins[index])[:2]
    assert kept == {3, 5, *near}
    assert 8 in near
    assert end.totals.problems == ()
    assert folder.kept(cases[3].id).bus_log.read_text() == f"{cases[3].id}\n"


def test_requested_logs_are_kept_whatever_the_result(tmp_path: Path) -> None:
    cases = asking(trial_cases(6), 3, verdict="fail")
    folder = folder_of(cases, tmp_path)
    wanted = cases[3].id, cases[4].id

    end = work(folder, wishes=CampaignOptions(keep=1, keep_worst=0, always=wanted))

    kept = [result.index for result in end.results if folder.kept(result.case_id).results.exists()]
    assert kept == [3, 4]


def test_a_case_that_gives_another_result_when_repeated_is_reported(tmp_path: Path) -> None:
    cases = asking(trial_cases(2), 0, fickle=True, verdict="fail")
    folder = folder_of(cases, tmp_path)
    work(folder)

    end = work(folder, wishes=CampaignOptions(keep=1, keep_worst=0))

    assert not end.totals.passed
    (problem,) = end.totals.problems
    assert problem.startswith(f"NOT DETERMINISTIC: {cases[0].id}")


def test_with_fail_fast_no_case_begins_after_the_first_failure(tmp_path: Path) -> None:
    folder = folder_of(asking(trial_cases(60), 2, verdict="fail"), tmp_path)

    end = work(folder, local(folder, 1), CampaignOptions(keep=0, keep_worst=0, fail_fast=True))

    assert end.totals.missing
    assert not end.totals.passed
    assert not end.interrupted


def test_real_time_runs_alone_and_last_with_its_logs_from_the_beginning(tmp_path: Path) -> None:
    cases = list(trial_cases(6))
    for index in (1, 3):
        cases[index] = msgspec.structs.replace(cases[index], bench=BenchKind.PROCESSES)
    folder, listener = folder_of(cases, tmp_path), Listener()
    handed: list[tuple[bool, int]] = []
    """For every batch: whether it must run alone, and how many batches are out at that time."""

    class Watched(LocalPool):
        def hand(self, batch: Batch) -> None:
            handed.append((batch.alone, self.busy))
            super().hand(batch)

    work(folder, lambda: Watched(2, {}, runner=RUNNER), listener=listener)

    assert [result.index for result in listener.results][-2:] == [1, 3]
    assert handed[-2:] == [(True, 0), (True, 0)]
    assert not any(alone for alone, _ in handed[:-2])
    assert max(out for _, out in handed[:-2]) > 0
    assert folder.kept(cases[1].id).bus_log.exists()


def test_output_of_a_runner_does_not_disturb_the_messages(tmp_path: Path) -> None:
    """Output of a runner goes to standard error and not between the messages."""
    folder = folder_of(trial_cases(2), tmp_path)

    end = work(folder, lambda: LocalPool(1, {}, runner="engine_rig_noise:run_case"))

    assert end.totals.passed


@pytest.fixture(autouse=True)
def noisy_runner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module that workers can import and that prints noise."""
    modules = tmp_path / "modules"
    modules.mkdir()
    (modules / "engine_rig_noise.py").write_text(
        '"""Noise."""\nfrom metro_hil.engine import trial_runner\n\n'
        "def run_case(case, **more):\n"
        "    print('noise' * 1000, flush=True)\n"
        "    return trial_runner.run_case(case, **more)\n"
    )
    before = os.environ.get("PYTHONPATH", "")
    monkeypatch.setenv("PYTHONPATH", f"{modules}{os.pathsep}{before}")


@pytest.fixture
def hanging_crew() -> Iterator[LocalPool]:
    crew = LocalPool(1, {}, runner=RUNNER)
    yield crew
    crew.close()


def test_cases_waiting_at_a_dying_worker_come_back_without_blame(
    hanging_crew: LocalPool,
) -> None:
    from metro_hil.engine.worker_pool import WorkerLost

    cases = asking(trial_cases(2), 0, hang=True)
    hanging_crew.hand(Batch(1, cases[:1]))
    hanging_crew.hand(Batch(2, cases[1:]))
    # The first message is the one that reports the worker ready.
    while not hanging_crew.ready:
        hanging_crew.wait(0.1)
    os.kill(hanging_crew.pids[0], signal.SIGKILL)

    outcomes = outcomes_of(hanging_crew, 2)
    assert [type(one) for one in outcomes] == [WorkerLost, WorkerLost]
    assert [one.begun for one in outcomes if isinstance(one, WorkerLost)] == [1, 0]
    assert hanging_crew.busy == 0


def test_workers_that_die_with_their_fork_server_are_replaced(hanging_crew: LocalPool) -> None:
    from metro_hil.engine.worker_pool import CaseFinished, WorkerLost

    cases = asking(trial_cases(2), 0, hang=True)
    hanging_crew.hand(Batch(1, cases[:1]))
    while not hanging_crew.ready:
        hanging_crew.wait(0.1)
    assert hanging_crew.server_pid is not None
    os.kill(hanging_crew.server_pid, signal.SIGKILL)

    assert [type(one) for one in outcomes_of(hanging_crew, 1)] == [WorkerLost]

    hanging_crew.hand(Batch(2, cases[1:]))
    (outcome,) = outcomes_of(hanging_crew, 1)
    assert isinstance(outcome, CaseFinished)
    assert outcome.result.case_id == cases[1].id


def outcomes_of(crew: LocalPool, count: int) -> list[Outcome]:
    outcomes: list[Outcome] = []
    clock = WallClock()
    end_ns = clock.now_ns() + round(WAIT_S * NS_PER_S)
    while len(outcomes) < count and clock.now_ns() < end_ns:
        outcomes += crew.wait(0.1)
    return outcomes


def test_pools_of_one_server_import_their_runner_once_and_share_no_worker(tmp_path: Path) -> None:
    imports = tmp_path / "imports"
    (tmp_path / "modules" / "engine_rig_counted.py").write_text(
        "from metro_hil.engine.trial_runner import run_case\n"
        f"with open({str(imports)!r}, 'a') as file:\n    file.write('imported\\n')\n"
    )
    workers: set[str] = set()

    with closing(PoolServer("engine_rig_counted:run_case")) as server:
        for name in ("one", "two"):
            folder = folder_of(trial_cases(12, work_s=0.02), tmp_path / name)
            end = work(folder, lambda: LocalPool(3, {}, server=server))
            own = {result.host.worker for result in end.results}
            assert len(own) == 3
            assert not own & workers
            workers |= own

    assert imports.read_text() == "imported\n"


def test_a_journal_in_use_is_not_touched(tmp_path: Path) -> None:
    folder = folder_of(trial_cases(2), tmp_path)
    journal = Journal(folder.journal_path, folder.head())

    with pytest.raises(EngineError, match="another process"):
        work(folder)

    journal.close()
    assert work(folder).totals.passed


def test_a_repeatedly_killed_master_neither_loses_nor_repeats_a_result(tmp_path: Path) -> None:
    """The kill instants are the same everywhere; another seed would change them."""
    cases = trial_cases(60, work_s=0.01)

    report = KillTrial(
        plan_of(cases, RUNNER, {"line": "a = 1"}), tmp_path, kills=10, life_s=1.0
    ).run()

    assert report.faults == []
    assert report.kills == 10
    assert report.campaigns >= 1
