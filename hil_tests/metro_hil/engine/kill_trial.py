"""Kills a campaign's master at random instants, again and again, and looks whether it shows.

    python -m metro_hil.engine.kill_trial --kills 100

The same cases are run once undisturbed. Whenever a killed campaign is complete at last, its results
and reports have to be those of the undisturbed one, with each case in its journal exactly once.
"""

import argparse
import hashlib
import random
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec

from firmware_py.assertions import require_assertions
from firmware_py.clock.clock import NS_PER_S, WallClock
from metro_hil.engine.folder import CampaignFolder, CampaignPlan, make_folder
from metro_hil.engine.journal import once_each, read_journal, without_host
from metro_hil.engine.trial_runner import trial_cases
from metro_hil.model.case import Case
from metro_hil.model.run_options import EXIT_FAILED, EXIT_OK

RUNNER: Final = "metro_hil.engine.trial_runner:run_case"
CASES: Final = 150
CASE_WORK_S: Final = 0.02
UNDISTURBED_S: Final = 600.0
BARREN_KILLS_MAX: Final = 20
"""So many kills in a row without a new result would go on for ever."""


@dataclass(slots=True)
class KillReport:
    """What the trial saw."""

    kills: int = 0
    campaigns: int = 0
    """That were completed in spite of the kills."""
    faults: list[str] = field(default_factory=list)
    """None if nothing was lost, doubled or different."""


@dataclass(frozen=True, slots=True)
class KillTrial:
    """What is run, and how often it is killed."""

    plan: CampaignPlan
    root: Path
    """Where the campaigns' folders are made."""
    kills: int
    seed: int = 1
    workers: int = 2
    reports: bool = False
    """Whether reports are written and compared, too."""
    life_s: float = 1.5
    """The master is killed at an instant drawn evenly from 0 to this after its start. It grows
    while nothing is achieved."""

    def run(self) -> KillReport:
        """Raises RuntimeError when not even the undisturbed campaign can be run."""
        wanted_folder = make_folder(self.plan, str(self.root / "undisturbed"))
        done = self._start(wanted_folder)
        output, errors = done.communicate(timeout=UNDISTURBED_S)
        if done.returncode not in (EXIT_OK, EXIT_FAILED):
            raise RuntimeError(errors.decode("utf-8", "replace"))
        wanted = _outcome(wanted_folder, output)
        report, dice = KillReport(), random.Random(self.seed)
        while report.kills < self.kills and not report.faults:
            folder = make_folder(self.plan, str(self.root / f"killed_{report.campaigns + 1}"))
            output = self._through(folder, dice, report)
            report.faults += _differences(folder, wanted, _outcome(folder, output))
            report.campaigns += 1
        return report

    def _through(self, folder: CampaignFolder, dice: random.Random, report: KillReport) -> bytes:
        """Resume and kill until the campaign ends by itself; what it then says."""
        clock, life_s, barren, results = WallClock(), self.life_s, 0, 0
        while True:
            master = self._start(folder)
            if report.kills < self.kills:
                clock.wait_until(clock.now_ns() + round(dice.uniform(0.0, life_s) * NS_PER_S))
                if master.poll() is None:
                    master.send_signal(signal.SIGKILL)
            output, errors = master.communicate(timeout=UNDISTURBED_S)
            if master.returncode in (EXIT_OK, EXIT_FAILED):
                return output
            if master.returncode != -signal.SIGKILL:
                report.faults.append(errors.decode("utf-8", "replace"))
                return output
            report.kills += 1
            new = len(read_journal(folder.journal_path).results)
            barren = barren + 1 if new == results else 0
            results = new
            if barren == BARREN_KILLS_MAX:
                # The machine is too slow for anything to happen in so short a life.
                life_s, barren = 2.0 * life_s, 0

    def _start(self, folder: CampaignFolder) -> "subprocess.Popen[bytes]":
        words = [sys.executable, "-m", "metro_hil.cli.hil", "resume", str(folder.path)]
        words += ["--json", "--workers", str(self.workers)]
        words += [] if self.reports else ["--no-report", "--keep", "0", "--keep-worst", "0"]
        # A session of its own, so that Ctrl-C does not count as one of the kills.
        return subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
        )


def _outcome(folder: CampaignFolder, output: bytes) -> dict[str, Any]:
    """All that has to be the same: results by case, totals, contents of the reports."""
    found = read_journal(folder.journal_path)
    results = {name: without_host(result) for name, result in once_each(found.results).items()}
    said: dict[str, Any] = msgspec.json.decode(output) if output else {}
    reports = {Path(path).name: _sha256(Path(path)) for path in said.pop("reports", [])}
    said.pop("folder", None)
    return {"results": results, "totals": said, "reports": reports}


def _differences(
    folder: CampaignFolder, wanted: dict[str, Any], found: dict[str, Any]
) -> list[str]:
    lines = Counter(result.case_id for result in read_journal(folder.journal_path).results)
    doubled = sorted(name for name, count in lines.items() if count > 1)
    faults = [f"{folder.path}: twice in the journal: {', '.join(doubled)}"] if doubled else []
    for part, content in wanted.items():
        if found[part] != content:
            keys = sorted(
                key for key in {*content, *found[part]} if content.get(key) != found[part].get(key)
            )
            faults.append(f"{folder.path}: other {part}: {', '.join(keys[:10])}")
    return faults


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def plan_of(cases: Sequence[Case], runner: str, files: dict[str, str]) -> CampaignPlan:
    return CampaignPlan(name="kill-trial", cases=cases, files=files, options={"runner": runner})


def main(argv: Sequence[str] | None = None) -> int:
    """Exit code 0 when nothing was lost, doubled or different."""
    require_assertions("kill_trial")
    parser = argparse.ArgumentParser(prog="kill_trial", description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1, help="of the instants")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--campaign", help="run this one instead of made-up cases")
    parser.add_argument("--limit", type=int, help="only so many of its cases")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory(prefix="kill_trial_") as root:
        trial = KillTrial(
            _chosen(options),
            Path(root),
            options.kills,
            seed=options.seed,
            workers=options.workers,
            reports=options.campaign is not None,
        )
        report = trial.run()
    if options.json:
        print(msgspec.json.encode(report).decode())
    else:
        print(f"{report.kills} kills, {report.campaigns} campaigns completed in spite of them")
        print("\n".join(report.faults) or "nothing lost, nothing doubled, nothing different")
    return EXIT_FAILED if report.faults else EXIT_OK


def _chosen(options: argparse.Namespace) -> CampaignPlan:
    if options.campaign is None:
        return plan_of(trial_cases(CASES, work_s=CASE_WORK_S), RUNNER, {})
    from metro_hil.campaign import plan_cases, read_campaign
    from metro_hil.engine.worker import RUNNER as BENCH

    campaign = read_campaign(options.campaign)
    return plan_of(plan_cases(campaign)[: options.limit], BENCH, campaign.files)


if __name__ == "__main__":
    sys.exit(main())
