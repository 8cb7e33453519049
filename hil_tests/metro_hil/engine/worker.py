"""A worker process: runs the cases that it receives, one at a time, until its master ends."""

import argparse
import gc
import importlib
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple, cast

import msgspec

from firmware_py.assertions import require_assertions
from firmware_py.clock.clock import WallClock
from firmware_py.clock.realtime import die_with_parent
from metro_hil.engine.messages import (
    LENGTH_BYTES,
    CaseBatch,
    Done,
    Over,
    Raised,
    ToMaster,
    WorkerHello,
    WorkerReady,
    pack,
    read_for_worker,
    read_length,
)
from metro_hil.model.case import Case, CaseResult
from metro_hil.model.gc_tuning import collect_rarely
from metro_hil.model.processor_time import processor_time_s
from metro_hil.model.run_folder import RunFolder

RUNNER: Final = "metro_hil.run.dispatch:run_case"
GROUP_FUNCTION: Final = "run_group"
"""Name of an optional function beside the runner. It takes the cases of one branch and yields their
results in order."""
NS_PER_S: Final = 1_000_000_000

Files = Mapping[str, Path]


def main(argv: Sequence[str] | None = None) -> int:
    """`hil` starts this program; people do not."""
    require_assertions("hil")
    parser = argparse.ArgumentParser(prog="hil worker", description=__doc__)
    parser.add_argument("--parent", type=int, required=True)
    parser.add_argument("--nice", type=int, default=0)
    options = parser.parse_args(argv)
    die_with_parent(options.parent)
    if options.nice:
        os.nice(options.nice)
    # Output that a runner prints must not mix with the messages to the master.
    to_master = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    # A case leaves few reference cycles, so the collector runs once in several cases.
    collect_rarely()
    serve(cast(BinaryIO, sys.stdin.buffer), cast(BinaryIO, to_master))
    # Skip the interpreter's cleanup, which takes longer than many cases.
    sys.stderr.flush()
    os._exit(0)


def serve(incoming: BinaryIO, outgoing: BinaryIO) -> None:
    """Answer messages until the incoming side is closed."""

    def say(message: ToMaster) -> None:
        outgoing.write(pack(message))
        outgoing.flush()

    bench: Runner | None = None
    while (body := _read(incoming)) is not None:
        message = read_for_worker(body)
        if isinstance(message, WorkerHello):
            bench = Runner(message.runner, {key: Path(at) for key, at in message.files.items()})
            # Exempt the imported modules from garbage collection.
            gc.freeze()
            say(WorkerReady())
            continue
        assert bench is not None, "a batch before the hello message"
        for answer in bench.run(message):
            say(answer)
        say(Over(message.number))


def _read(incoming: BinaryIO) -> bytes | None:
    head = incoming.read(LENGTH_BYTES)
    if len(head) < LENGTH_BYTES:
        return None
    body = incoming.read(read_length(head))
    return body if len(body) == read_length(head) else None


class _Began(NamedTuple):
    """Start of a case: wall clock, and processor time of this process."""

    now_ns: int
    processor_s: float


class Runner:
    """Holds the function that runs a case, and its module's function for groups, if any."""

    def __init__(self, name: str, files: Files) -> None:
        """Raises ImportError or AttributeError if there is no such function."""
        module_name, _, function = name.partition(":")
        module = importlib.import_module(module_name)
        self._run_case: Callable[..., CaseResult] = getattr(module, function)
        self._run_group: Callable[..., Iterator[CaseResult]] | None = getattr(
            module, GROUP_FUNCTION, None
        )
        self._files = files
        self._clock = WallClock()

    def run(self, job: CaseBatch) -> Iterator[ToMaster]:
        """Yield results as they come. After an exception in a group, run the rest one by one."""
        left = list(job.cases)
        if len(left) > 1 and self._run_group is not None:
            yield from self._group(job, left)
        for case in left:
            yield self._single(job, case)

    def _group(self, job: CaseBatch, left: list[Case]) -> Iterator[ToMaster]:
        """Run the cases as a group, and remove those that are done from `left`."""
        assert self._run_group is not None
        began = self._begin()
        try:
            for result in self._run_group(tuple(left), files=self._files):
                assert result.case_id == left[0].id, "results of a group come in order"
                yield Done(job.number, self._signed(result, began))
                left.pop(0)
                began = self._begin()
        except Exception:
            yield Raised(job.number, left.pop(0).id, traceback.format_exc())

    def _single(self, job: CaseBatch, case: Case) -> ToMaster:
        began = self._begin()
        keep: dict[str, Any] = {}
        if job.folder is not None:
            keep["folder"] = RunFolder(Path(job.folder))
        try:
            result = self._run_case(case, files=self._files, **keep)
            assert result.case_id == case.id
            return Done(job.number, self._signed(result, began))
        except Exception:
            return Raised(job.number, case.id, traceback.format_exc())

    def _begin(self) -> "_Began":
        return _Began(self._clock.now_ns(), processor_time_s())

    def _signed(self, result: CaseResult, began: "_Began") -> CaseResult:
        """Add worker, wall time and processor time, and convert to what the journal gives back."""
        wall_s = result.host.wall_s or (self._clock.now_ns() - began.now_ns) / NS_PER_S
        processor_s = processor_time_s() - began.processor_s
        worker = f"{os.uname().nodename}:{os.getpid()}"
        times = {"wall_s": wall_s, "processor_s": processor_s}
        host = msgspec.structs.replace(result.host, worker=worker, **times)
        signed = msgspec.structs.replace(result, host=host)
        return msgspec.json.decode(msgspec.json.encode(signed), type=CaseResult)


if __name__ == "__main__":
    sys.exit(main())
