"""A campaign on a Dask cluster gives identical results, whichever worker dies meanwhile."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hil_tests.real_time.engine_rig import (
    RUNNER,
    Listener,
    asking,
    folder_of,
    local,
    plain,
    trial_cases,
    work,
)
from metro_hil.engine import dask_pool
from metro_hil.engine.dask_pool import DaskPool
from metro_hil.engine.errors import EngineError
from metro_hil.engine.journal import read_journal
from metro_hil.engine.program import program_version


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two worker processes on this machine with the present sources."""
    import distributed

    program_version.cache_clear()

    cluster: Any = distributed.LocalCluster
    with cluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as made:
        yield made


def on(cluster: Any, folder: Any, timeout_s: float | None = None) -> Any:
    """A factory for a worker pool on the cluster."""
    address = cluster.scheduler_address
    return lambda: DaskPool(address, folder.files(), runner=RUNNER, case_timeout_s=timeout_s)


def test_the_results_equal_those_of_this_machine(cluster: Any, tmp_path: Path) -> None:
    here, there = (folder_of(trial_cases(150), tmp_path, line="a = 1") for _ in range(2))

    at_home, away = work(here, local(here)), work(there, on(cluster, there))

    assert plain(away) == plain(at_home)
    assert away.totals == at_home.totals
    assert len(read_journal(there.journal_path).results) == 150


def test_a_case_that_dies_hangs_or_raises_there_costs_no_other(
    cluster: Any, tmp_path: Path
) -> None:
    cases = asking(trial_cases(8), 1, die_unless="")
    cases = asking(cases, 3, hang=True)
    cases = asking(cases, 5, die_unless=str(tmp_path / "died"))
    cases = asking(cases, 6, **{"raise": "our mistake"})
    folder, listener = folder_of(cases, tmp_path), Listener()

    end = work(folder, on(cluster, folder, timeout_s=0.5), listener=listener)

    verdicts = [result.verdict.value for result in end.results]
    assert verdicts == ["pass", "lost", "pass", "lost", "pass", "pass", "lost", "pass"]
    attempts = [result.host.attempts for result in end.results]
    assert attempts == [1, 3, 1, 3, 1, 2, 1, 1]
    assert "SIGKILL" in end.results[1].reason
    assert "no result within" in end.results[3].reason


def test_a_cluster_worker_that_is_killed_costs_no_result(cluster: Any, tmp_path: Path) -> None:
    """Dask's nanny starts another worker; meanwhile the scheduler gives its tasks to the rest."""
    folder = folder_of(trial_cases(60, work_s=0.01), tmp_path)

    class Killer(Listener):
        def result(self, case: Any, result: Any) -> None:
            super().result(case, result)
            if len(self.results) == 10:
                next(iter(cluster.workers.values())).process.process.kill()

    end = work(folder, on(cluster, folder), listener=Killer())

    assert end.totals.passed
    assert len(read_journal(folder.journal_path).results) == 60


def test_a_worker_with_another_version_is_refused(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the cluster's point of view this program has the other version."""
    folder = folder_of(trial_cases(2), tmp_path)
    monkeypatch.setattr(dask_pool, "program_version", lambda: "9.9.9+other")

    with pytest.raises(EngineError, match=r"version 0\.\S+ of this project, here it is 9\.9\.9\+"):
        work(folder, on(cluster, folder))

    assert read_journal(folder.journal_path).results == []


def test_a_worker_with_another_version_that_comes_later_computes_nothing(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = folder_of(trial_cases(2), tmp_path)
    monkeypatch.setattr(DaskPool, "_check_programs", lambda crew: None)
    monkeypatch.setattr(dask_pool, "program_version", lambda: "9.9.9+other")

    with pytest.raises(EngineError, match="worker that came later has version"):
        work(folder, on(cluster, folder))

    assert read_journal(folder.journal_path).results == []


def test_a_missing_scheduler_is_reported_with_its_address(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dask_pool, "CONNECT_S", 0.5)

    with pytest.raises(EngineError, match=r"dask://127\.0\.0\.1:9: no scheduler answers"):
        DaskPool("127.0.0.1:9", {}, runner=RUNNER)
