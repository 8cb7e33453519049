"""Reads the campaigns of a folder for `hil serve`: finished ones from their summaries, others from
their journals.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec

from metro_hil.engine.errors import EngineError
from metro_hil.engine.folder import MANIFEST, CampaignFolder, Manifest
from metro_hil.engine.journal import decode_line, read_journal
from metro_hil.model.case import Case, CaseResult, Verdict, mismatch

SUMMARY: Final = "summary.json"
DEPTHS: Final = ("", "*/", "*/*/")
"""Where campaigns are looked for: the served folder, its folders, and theirs, as in copies."""
FRESH_NS: Final = 60_000_000_000
"""Age of a journal's last line up to which its campaign counts as running."""
COPIED_NS: Final = 2_000_000_000
"""A summary is up to date if the journal is at most this much newer, as a copied folder may be."""
FAILURES_MAX: Final = 200
"""Most failures of a running campaign that the list shows."""


class _Head(msgspec.Struct):
    name: str
    title: str = ""
    bench: str = ""
    fingerprint: str = ""


class _Totals(msgspec.Struct):
    cases: int
    done: int
    as_expected: int
    counts: dict[str, int]


class _Scenario(msgspec.Struct):
    cases: int
    as_expected: int


class _Least(msgspec.Struct):
    margin: float | None
    case_id: str


class _Monitor(msgspec.Struct):
    name: str
    unit: str
    failed: int = 0
    margin_least: _Least | None = None


class _Summary(msgspec.Struct):
    """The parts of summary.json that the list needs."""

    campaign: _Head
    passed: bool
    totals: _Totals
    scenarios: dict[str, _Scenario]
    monitors: list[_Monitor]


@dataclass(slots=True)
class _Known:
    """What was read of one campaign, and the files' state at that time."""

    stamp: tuple[int, ...] = ()
    row: dict[str, Any] = field(default_factory=dict)
    journal: "_Journal | None" = None


class _Journal:
    """Results of a campaign without a summary, read as they come."""

    def __init__(self, folder: CampaignFolder) -> None:
        self._folder = folder
        self._cases: Mapping[str, Case] = {case.id: case for case in folder.cases()}
        self._offset = 0
        self._results: dict[str, CaseResult] = {}
        self.damaged = 0

    def read(self) -> None:
        """Read the lines that were added since the last call."""
        with suppress(FileNotFoundError), self._folder.journal_path.open("rb") as file:
            file.seek(self._offset)
            text = file.read()
            end = text.rfind(b"\n") + 1
            self._offset += end
            for line in text[:end].splitlines():
                entry = decode_line(line)
                if entry is None:
                    self.damaged += 1
                elif entry.result is not None:
                    self._results[entry.result.case_id] = entry.result

    def row(self) -> dict[str, Any]:
        scenarios: dict[str, list[int]] = {}
        counts: dict[str, int] = {}
        failures = []
        for name, case in self._cases.items():
            result = self._results.get(name)
            if result is None:
                continue
            why = mismatch(case, result)
            scenario = scenarios.setdefault(case.scenario, [0, 0])
            scenario[0] += 1
            scenario[1] += not why
            counts[result.verdict.value] = counts.get(result.verdict.value, 0) + 1
            if why:
                failures.append([name, why])
        return {
            "cases": len(self._cases),
            "done": len(self._results),
            "good": sum(good for _, good in scenarios.values()),
            "counts": counts,
            "scenarios": scenarios,
            "margins": {},
            "failures": failures[-FAILURES_MAX:],
        }


class Shelf:
    """All campaigns in a folder. Each is read again only if its files changed."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._known: dict[str, _Known] = {}
        self.version = 0
        """Rises with each change."""

    def look(self, now_ns: int) -> list[dict[str, Any]]:
        """Return one row for each campaign, the oldest first."""
        found = {self._name(path): path for depth in DEPTHS for path in self._manifests(depth)}
        rows = {name: self._row(name, path.parent, now_ns) for name, path in found.items()}
        gone = self._known.keys() - found.keys()
        for name in gone:
            del self._known[name]
        self.version += bool(gone)
        return sorted(rows.values(), key=lambda row: (row["started"], row["path"]))

    def folder(self, name: str) -> CampaignFolder | None:
        """Return a campaign by its path as in the rows; None for any other text."""
        return CampaignFolder(self.root / name) if name in self._known else None

    def _manifests(self, depth: str) -> list[Path]:
        return sorted(self.root.glob(f"{depth}{MANIFEST}"))

    def _name(self, manifest: Path) -> str:
        return manifest.parent.relative_to(self.root).as_posix()

    def _row(self, name: str, path: Path, now_ns: int) -> dict[str, Any]:
        known = self._known.setdefault(name, _Known())
        folder = CampaignFolder(path)
        summary, journal = _changed_ns(path / SUMMARY), _changed_ns(folder.journal_path)
        finished = summary > journal - COPIED_NS
        running = not finished and now_ns - journal < FRESH_NS
        stamp = (_changed_ns(folder.manifest_path), summary, journal, running)
        if known.stamp != stamp:
            known.stamp = stamp
            self.version += 1
            known.row = {"path": name, **_read(known, folder, finished=finished, running=running)}
        return known.row


def _changed_ns(path: Path) -> int:
    """Return when a file was last written; 0 if there is none."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _read(
    known: _Known, folder: CampaignFolder, *, finished: bool, running: bool
) -> dict[str, Any]:
    """Return what the list shows of a campaign; of a damaged one, what is wrong with it."""
    row: dict[str, Any] = {"name": folder.path.name, "title": "", "started": "", "program": ""}
    try:
        manifest = folder.manifest()
        row |= _head(manifest)
        if finished:
            known.journal = None
            return row | _finished(folder.path / SUMMARY)
        if known.journal is None:
            known.journal = _Journal(folder)
        known.journal.read()
        state = "running" if running else "unfinished"
        if known.journal.damaged:
            row["problem"] = f"{known.journal.damaged} damaged lines in its journal"
        return row | known.journal.row() | {"state": state}
    except (EngineError, OSError) as error:
        return row | {**NOTHING, "state": "unreadable", "problem": str(error)}


NOTHING: Final[Mapping[str, Any]] = {
    "cases": 0,
    "done": 0,
    "good": 0,
    "counts": {},
    "scenarios": {},
    "margins": {},
}


def _head(manifest: Manifest) -> dict[str, Any]:
    return {
        "name": manifest.name,
        "title": manifest.title,
        "started": manifest.started,
        "program": manifest.program,
        "fingerprint": manifest.fingerprint,
        "subset": manifest.subset,
    }


def _finished(path: Path) -> dict[str, Any]:
    """Raises EngineError."""
    try:
        found = msgspec.json.decode(path.read_bytes(), type=_Summary)
    except msgspec.DecodeError as error:
        raise EngineError(f"{path}: {error}; `hil report {path.parent}` writes it again") from error
    return {
        "state": "passed" if found.passed else "failed",
        "cases": found.totals.cases,
        "done": found.totals.done,
        "good": found.totals.as_expected,
        "counts": {name: count for name, count in found.totals.counts.items() if count},
        "scenarios": {
            name: [each.cases, each.as_expected] for name, each in found.scenarios.items()
        },
        "margins": {
            each.name: [each.margin_least.margin, each.unit, each.margin_least.case_id]
            for each in found.monitors
            if each.margin_least is not None and each.margin_least.margin is not None
        },
    }


def cases_of(folder: CampaignFolder) -> list[dict[str, Any]]:
    """Return one row for each case of a campaign, in its order. Raises EngineError."""
    results = {each.case_id: each for each in read_journal(folder.journal_path).results}
    return [_case(folder, case, results.get(case.id)) for case in folder.cases()]


def _case(folder: CampaignFolder, case: Case, result: CaseResult | None) -> dict[str, Any]:
    row: dict[str, Any] = {"id": case.id, "scenario": case.scenario, "verdict": "missing"}
    if result is None:
        return row | {"good": False, "why": "no result came back", "kept": False}
    why = mismatch(case, result)
    failed = [each for each in result.monitors if each.verdict is Verdict.FAIL]
    worst = failed[0] if failed else result.least_margin()
    return row | {
        "verdict": result.verdict.value,
        "good": not why,
        "why": why or result.reason,
        "kept": (folder.kept(case.id).bus_log).is_file(),
        "margin": None if worst is None else worst.margin,
        "unit": "" if worst is None else worst.unit,
        "monitor": "" if worst is None else worst.name,
        "at_s": None if worst is None else worst.at_s,
    }
