"""Kills a campaign's master at random instants, or fills its disk, and compares the results.

    python -m metro_hil.engine.kill_trial --kills 100
    unshare --map-root-user --mount python -m metro_hil.engine.kill_trial --full-disks 10

The trial first runs the same cases undisturbed. When a disturbed campaign is complete, its results
and reports must equal those of the undisturbed one, with each case in its journal exactly once. A
disk is full for one life of the master: a filler file leaves a random part of the space that the
campaign still needs. The master must then end with exit code 3, one line that names the disk, and
no traceback.
"""

import argparse
import errno
import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
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
from metro_hil.model.run_options import EXIT_ENVIRONMENT, EXIT_FAILED, EXIT_OK

RUNNER: Final = "metro_hil.engine.trial_runner:run_case"
CASES: Final = 150
CASE_WORK_S: Final = 0.02
UNDISTURBED_S: Final = 600.0
KEEP_WORST: Final = 3
DISK: Final = "256m"
"""Size of the file system that the trial fills: room for several whole campaigns."""
FULL: Final = (os.strerror(errno.ENOSPC).encode(), b"the disk did not take")
"""Texts of which a master must print one when the disk is full."""
BLOCK_BYTES: Final = 512
"""Unit of `st_blocks`."""
BARREN_KILLS_MAX: Final = 20
"""Maximum number of kills in a row without a new result, after which the master lives longer."""


@dataclass(slots=True)
class KillReport:
    """Counts and faults of a trial."""

    kills: int = 0
    full_disks: int = 0
    campaigns: int = 0
    """Number of campaigns that were completed in spite of the disturbances."""
    faults: list[str] = field(default_factory=list)
    """Results that were lost, doubled or different; empty if all is well."""


@dataclass(frozen=True, slots=True)
class KillTrial:
    """The campaign to run, and how often the trial disturbs it."""

    plan: CampaignPlan
    root: Path
    """Folder in which the campaigns' folders are made."""
    kills: int
    full_disks: int = 0
    """Number of full disks; if there are any, `root` must be a small file system of its own."""
    seed: int = 1
    workers: int = 2
    reports: bool = False
    """Whether reports are written and compared as well."""
    life_s: float = 1.5
    """The master is killed at an instant sampled evenly from 0 to this after its start, or to its
    undisturbed run time if that is longer. It doubles while kills give no new result."""

    def run(self) -> KillReport:
        """Run the trial. Raises RuntimeError if the undisturbed campaign fails to run."""
        began_ns = WallClock().now_ns()
        wanted_folder = make_folder(self.plan, str(self.root / "undisturbed"))
        done = self._start(wanted_folder)
        output, errors = done.communicate(timeout=UNDISTURBED_S)
        if done.returncode not in (EXIT_OK, EXIT_FAILED):
            raise RuntimeError(errors.decode("utf-8", "replace"))
        life_s = max(self.life_s, (WallClock().now_ns() - began_ns) / NS_PER_S)
        wanted, size = _outcome(wanted_folder, output), _size(wanted_folder.path)
        report, dice = KillReport(), random.Random(self.seed)
        while self._left(report) and not report.faults:
            folder = make_folder(self.plan, str(self.root / f"disturbed_{report.campaigns + 1}"))
            output = self._through(folder, dice, report, life_s, size)
            report.faults += _differences(folder, wanted, _outcome(folder, output))
            report.campaigns += 1
            if not report.faults:
                shutil.rmtree(folder.path)
        return report

    def _left(self, report: KillReport) -> int:
        """Number of disturbances still to come."""
        return self.kills + self.full_disks - report.kills - report.full_disks

    def _through(
        self,
        folder: CampaignFolder,
        dice: random.Random,
        report: KillReport,
        life_s: float,
        size: int,
    ) -> bytes:
        """Resume and disturb until the campaign ends by itself; return its output.

        Args:
            life_s: maximum time from the master's start to its kill.
            size: size of the whole folder, in bytes.
        """
        clock, barren, results = WallClock(), 0, 0
        while True:
            left = self._left(report)
            full = left > 0 and dice.randrange(left) >= self.kills - report.kills
            with _filled(self.root, folder.path, dice, size) if full else nullcontext():
                master = self._start(folder)
                if left and not full:
                    clock.wait_until(clock.now_ns() + round(dice.uniform(0.0, life_s) * NS_PER_S))
                    if master.poll() is None:
                        master.send_signal(signal.SIGKILL)
                output, errors = master.communicate(timeout=UNDISTURBED_S)
            if master.returncode in (EXIT_OK, EXIT_FAILED):
                return output
            if full and _says_full(master.returncode, errors):
                report.full_disks += 1
            elif master.returncode == -signal.SIGKILL and not full:
                report.kills += 1
            else:
                report.faults.append(errors.decode("utf-8", "replace"))
                return output
            new = len(read_journal(folder.journal_path).results)
            barren = barren + 1 if new == results else 0
            results = new
            if barren == BARREN_KILLS_MAX:
                # The machine is too slow for a case to finish in this time.
                life_s, barren = 2.0 * life_s, 0

    def _start(self, folder: CampaignFolder) -> "subprocess.Popen[bytes]":
        words = [sys.executable, "-m", "metro_hil.cli.hil", "resume", str(folder.path)]
        words += ["--json", "--workers", str(self.workers)]
        words += [] if self.reports else ["--no-report", "--keep", "0", "--keep-worst", "0"]
        # The master has its own session, so that Ctrl-C does not count as a kill.
        return subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
        )


@contextmanager
def _filled(root: Path, folder: Path, dice: random.Random, size: int) -> Iterator[None]:
    """Fill the disk, except for a random part of the space that a campaign still needs."""
    filler, needed = root / "filler", max(1, size - _size(folder))
    stat = os.statvfs(root)
    with filler.open("wb") as file:
        os.posix_fallocate(
            file.fileno(), 0, max(1, stat.f_bavail * stat.f_frsize - dice.randrange(needed))
        )
    try:
        yield
    finally:
        filler.unlink()


def _size(folder: Path) -> int:
    """Bytes that all files in a folder occupy on the disk."""
    return sum(path.stat().st_blocks * BLOCK_BYTES for path in folder.rglob("*"))


def _says_full(code: int, errors: bytes) -> bool:
    """Whether a master ended as required on a full disk."""
    told = [line for line in errors.splitlines() if line.startswith(b"hil: ")]
    return (
        code == EXIT_ENVIRONMENT
        and len(told) == 1
        and any(words in told[0] for words in FULL)
        and b"Traceback" not in errors
    )


def _outcome(folder: CampaignFolder, output: bytes) -> dict[str, Any]:
    """Everything that must be equal: results by case, totals, contents of the reports."""
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
    options = {"runner": runner, "keep_worst": KEEP_WORST}
    return CampaignPlan(name="kill-trial", cases=cases, files=files, options=options)


def main(argv: Sequence[str] | None = None) -> int:
    """Exit code 0 when no result was lost, doubled or different."""
    require_assertions("kill_trial")
    parser = argparse.ArgumentParser(prog="kill_trial", description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument(
        "--full-disks", type=int, default=0, help="number of full disks; needs the right to mount"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the random instants")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--campaign", help="run this one instead of made-up cases")
    parser.add_argument("--limit", type=int, help="run only its first LIMIT cases")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory(prefix="kill_trial_") as root, ExitStack() as stack:
        if options.full_disks:
            subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK}", "disk", root], check=True)
            stack.callback(subprocess.run, ["umount", root], check=True)
        trial = KillTrial(
            _chosen(options),
            Path(root),
            options.kills,
            full_disks=options.full_disks,
            seed=options.seed,
            workers=options.workers,
            reports=True,
        )
        report = trial.run()
    if options.json:
        print(msgspec.json.encode(report).decode())
    else:
        disturbed = f"{report.kills} kills, {report.full_disks} full disks"
        print(f"{disturbed}, {report.campaigns} campaigns completed in spite of them")
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
