"""Messages between master and worker: JSON, each with its length before it."""

import struct
from collections.abc import Iterator
from typing import Final

import msgspec

from metro_hil.model.case import Case, CaseResult

_LENGTH: Final = struct.Struct("<I")
LENGTH_BYTES: Final = _LENGTH.size


class WorkerHello(msgspec.Struct, frozen=True, tag="hello"):
    """Master to worker, once: what the worker needs before its first batch."""

    runner: str
    """`module:function`; called like `metro_hil.run.dispatch.run_case`."""
    files: dict[str, str]
    """Paths, by the name by which cases refer to a file."""


class CaseBatch(msgspec.Struct, frozen=True, tag="job"):
    """Master to worker: run these cases one after the other."""

    number: int
    cases: tuple[Case, ...]
    folder: str | None = None
    """Folder for the logs, if the batch is a single case whose logs are kept."""


class WorkerReady(msgspec.Struct, frozen=True, tag="ready"):
    """Worker to master, once: all modules are imported."""


class Done(msgspec.Struct, frozen=True, tag="done"):
    """Worker to master: one case of a batch has its result."""

    number: int
    result: CaseResult


class Raised(msgspec.Struct, frozen=True, tag="raised"):
    """Worker to master: the runner raised an exception, which is a mistake of this program."""

    number: int
    case_id: str
    traceback: str


class Over(msgspec.Struct, frozen=True, tag="over"):
    """Worker to master: the batch is over."""

    number: int


ToWorker = WorkerHello | CaseBatch
ToMaster = WorkerReady | Done | Raised | Over

_encoder: Final = msgspec.json.Encoder()
_of_master: Final = msgspec.json.Decoder(ToWorker)
_of_worker: Final = msgspec.json.Decoder(ToMaster)


def pack(message: ToWorker | ToMaster) -> bytes:
    body = _encoder.encode(message)
    return _LENGTH.pack(len(body)) + body


def read_length(head: bytes) -> int:
    """Number of bytes in the body that follows the `LENGTH_BYTES` of `head`."""
    length: int = _LENGTH.unpack(head)[0]
    return length


def read_for_worker(body: bytes) -> ToWorker:
    message: ToWorker = _of_master.decode(body)
    return message


def take_for_master(received: bytearray) -> Iterator[ToMaster]:
    """Yield the whole messages at the front of `received`, and remove them from it."""
    while len(received) >= LENGTH_BYTES:
        end = LENGTH_BYTES + read_length(bytes(received[:LENGTH_BYTES]))
        if len(received) < end:
            return
        body = bytes(received[LENGTH_BYTES:end])
        del received[:end]
        yield _of_worker.decode(body)
