"""Runs test files on the compiled copy, in a process of their own, once the copy is ready.

These files compute for seconds. Their tests that replace a part of a compiled module have the mark
`sources`, and always run in the process of their worker, in plain Python. So do all tests until the
copy is ready, and with VOBC_NATIVE=wire or off.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TextIO

import pytest

from metro_hil.model.native_copy import SWITCH, Native, usable_copy, worker_environment

ON_COPY: Final = frozenset(
    {
        "test_ato_stops",
        "test_behind_another_train",
        "test_bench_as_a_whole",
        "test_case_runs",
        "test_closed_loop_florence",
        "test_controllers_of_cases",
        "test_faults_leave_no_trace",
        "test_hil_acceptance",
        "test_odometry_truth",
        "test_published_figures",
        "test_replay_of_cases",
    }
)
"""Names of these files. Unit tests of protection and odometry and the recorded frames stay with the
sources."""
TOGETHER: Final = frozenset(
    {
        "test_ato_chasing",
        "test_ato_orders",
        "test_ato_pid_law",
        "test_ato_power_limited",
        "test_ato_rail",
        "test_ato_receding",
        "test_ato_station_work",
        "test_ato_timing",
        "test_drivers",
        "test_explain_closed_loop",
        "test_faults_closed_loop",
        "test_from_log",
        "test_guide_scenario",
        "test_hil_init",
        "test_hil_search",
        "test_interrupted_runs",
        "test_line_of_trains",
        "test_monitors_closed_loop",
        "test_no_false_green",
        "test_odometry_axles",
        "test_one_fault",
        "test_output_stages",
        "test_power_limited_run",
        "test_protection_modes",
        "test_protection_properties",
        "test_protection_stations",
        "test_replay",
        "test_turnback",
        "test_zones",
    }
)
"""Names of shorter files that share a process, because its start takes longer than a second."""
GROUP: Final = "on the copy"
SOURCES: Final = "sources"
"""Mark of tests that run on the sources."""
Reports = Mapping[str, Sequence[pytest.TestReport]]


def group_of(path: Path) -> str:
    """Return what all files of one process on the copy have in common."""
    return GROUP if path.stem in TOGETHER else path.stem


class CompiledFiles:
    """The part in the worker: hands a file on, and reports its tests as if they had run here."""

    def __init__(
        self,
        config: pytest.Config,
        files: frozenset[str] = ON_COPY | TOGETHER,
        copy: Callable[[], Path | None] = usable_copy,
    ) -> None:
        self._config = config
        self._files = files
        self._copy = copy
        self._reports: dict[str, Reports | None] = {}

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(
        self, item: pytest.Item, nextitem: pytest.Item | None
    ) -> bool | None:
        if not self._takes(item):
            return None
        group = group_of(item.path)
        if group not in self._reports:
            copy = self._copy()
            items = [each for each in item.session.items if group_of(each.path) == group]
            names = [each.nodeid for each in items if self._takes(each)]
            self._reports[group] = None if copy is None else self._run(copy, names)
        reports = self._reports[group]
        if reports is None:
            return None
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for report in reports[item.nodeid]:
            item.ihook.pytest_runtest_logreport(report=report)
        # The test before left standing what this test would share with it. The hook of the teardown
        # would expect that this test was set up here.
        item.session._setupstate.teardown_exact(nextitem)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def _takes(self, item: pytest.Item) -> bool:
        return item.path.stem in self._files and item.get_closest_marker(SOURCES) is None

    def _run(self, copy: Path, names: Sequence[str]) -> Reports:
        """Run these tests on the copy. A test without a report has failed."""
        with tempfile.NamedTemporaryFile("r", encoding="utf-8") as file:
            done = subprocess.run(
                [sys.executable, "-m", __name__, file.name, *names],
                cwd=self._config.rootpath,
                env=worker_environment({**os.environ, SWITCH: Native.WIRE.value}, copy),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                check=False,
            )
            found: dict[str, list[pytest.TestReport]] = {name: [] for name in names}
            for line in file:
                report = self._config.hook.pytest_report_from_serializable(
                    config=self._config, data=json.loads(line)
                )
                found[report.nodeid].append(report)
        for name, reports in found.items():
            if not any(each.when == "teardown" for each in reports):
                where = (name.partition("::")[0], None, name)
                reports.append(pytest.TestReport(name, where, {}, "failed", done.stdout, "call"))
        return found


class ReportWriter:
    """The part in the process on the copy: writes each report as a line of JSON."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    def pytest_configure(self, config: pytest.Config) -> None:
        self._config = config

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        data: Mapping[str, Any] = self._config.hook.pytest_report_to_serializable(
            config=self._config, report=report
        )
        print(json.dumps(data), file=self._file, flush=True)


if __name__ == "__main__":
    with Path(sys.argv[1]).open("w", encoding="utf-8") as opened:
        words = ["-p", "no:cacheprovider", "-p", "no:xdist", *sys.argv[2:]]
        sys.exit(pytest.main(words, plugins=[ReportWriter(opened)]))
