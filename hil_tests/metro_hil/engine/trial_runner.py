"""A runner that simulates nothing and misbehaves on request, to test the engine.

The keys below, in the case's `setup.real`, say how it treats a case.
"""

import hashlib
import os
import signal
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from firmware_py.clock.clock import NS_PER_S, WallClock
from metro_hil.model.case import Case, CaseEvent, CaseResult, MonitorResult, Setup, Verdict
from metro_hil.model.run_folder import RunFolder

WORK_S: Final = "trial.work_s"
"""Time during which the runner keeps a processor busy, s."""
DIE_UNLESS: Final = "trial.die_unless"
"""Kill the worker unless this file exists; the first death creates it. Empty: always die."""
HANG: Final = "trial.hang"
RAISE: Final = "trial.raise"
VERDICT: Final = "trial.verdict"
FICKLE: Final = "trial.fickle"
"""Give a different result in each process."""


def run_case(
    case: Case, *, files: Mapping[str, Path] | None = None, folder: RunFolder | None = None
) -> CaseResult:
    """Return a result that depends only on the case and the files."""
    asked = case.setup.real
    _work(float(asked.get(WORK_S, 0.0)))
    if DIE_UNLESS in asked:
        _die_unless(str(asked[DIE_UNLESS]))
    if asked.get(HANG):
        signal.pause()
    if RAISE in asked:
        raise RuntimeError(str(asked[RAISE]))
    digest = hashlib.sha256(f"{case.id} {case.seed}".encode())
    for name, path in sorted((files or {}).items()):
        digest.update(name.encode() + path.read_bytes())
    if asked.get(FICKLE):
        digest.update(str(os.getpid()).encode())
    if folder is not None:
        folder.path.mkdir(parents=True, exist_ok=True)
        folder.bus_log.write_text(f"{case.id}\n", encoding="utf-8")
    return _result(case, digest.digest())


def run_group(
    cases: Sequence[Case], *, files: Mapping[str, Path] | None = None
) -> Iterator[CaseResult]:
    """Run the cases one after the other."""
    for case in cases:
        yield run_case(case, files=files)


def _result(case: Case, digest: bytes) -> CaseResult:
    verdict = Verdict(case.setup.real.get(VERDICT, "pass"))
    margin = int.from_bytes(digest[:2], "big") / 65536.0 * (1 if verdict is Verdict.PASS else -1)
    monitor = MonitorResult(
        name="trial",
        verdict=verdict,
        margin=margin,
        unit="m/s",
        at_s=1.0,
        detail="",
        requirements=(),
    )
    return CaseResult(
        case_id=case.id,
        index=case.index,
        verdict=verdict,
        reason="" if verdict is Verdict.PASS else f"asked to {verdict.value}",
        exit_reason="arrived",
        sim_s=1.0,
        frames=1,
        chain=digest.hex(),
        monitors=(monitor,),
        measures={"trial_margin_mps": margin},
        events=(CaseEvent(0.0, "began"),),
    )


def _work(work_s: float) -> None:
    clock = WallClock()
    end_ns = clock.now_ns() + round(work_s * NS_PER_S)
    while clock.now_ns() < end_ns:
        pass


def _die_unless(name: str) -> None:
    if name and Path(name).exists():
        return
    if name:
        Path(name).touch()
    os.kill(os.getpid(), signal.SIGKILL)


def trial_cases(count: int, scenario: str = "trial", **asked: object) -> tuple[Case, ...]:
    """Cases for this runner, which differ only in their seeds.

    Args:
        asked: keys of this module without their `trial.`.
    """
    real = {f"trial.{key}": value for key, value in asked.items()}
    return tuple(
        Case(
            id=f"{scenario}/{index:04d}-s{index + 1}",
            index=index,
            scenario=scenario,
            seed=index + 1,
            setup=Setup(real=real),
        )
        for index in range(count)
    )
