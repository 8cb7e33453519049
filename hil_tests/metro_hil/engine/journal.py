"""The journal of a campaign: one line for each result, each with a checksum, never rewritten.

A line is a JSON object whose first member is the checksum (BLAKE2b, 8 bytes) of the rest of the
line:

    {"sum":"0f1e2d3c4b5a6978","result":{"case_id":"..."}}

The journal passes each line to the kernel at once, so that `kill -9` loses at most the line that is
being written. It flushes to the disk at least every `SYNC_S`.
"""

import fcntl
import hashlib
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec

from firmware_py.clock.clock import NS_PER_S, WallClock
from firmware_py.storage.whole_file import write_whole
from metro_hil.engine.errors import EngineError
from metro_hil.model.case import CaseResult

SYNC_S: Final = 0.2
_OPENING: Final = b'{"sum":"'
_SUM_DIGITS: Final = 16
_BODY_FROM: Final = len(_OPENING) + _SUM_DIGITS + 2


class JournalHead(msgspec.Struct, frozen=True):
    """Names the campaign that the journal belongs to."""

    fingerprint: str
    """Fingerprint of the campaign."""
    cases: int


class Session(msgspec.Struct, frozen=True):
    """A process began to run the campaign, or resumed it."""

    at: str
    program: str
    crew: str


class LostAttempt(msgspec.Struct, frozen=True):
    """A worker began a case, then died or hung."""

    case_id: str
    attempt: int
    reason: str


class JournalLine(msgspec.Struct, frozen=True, omit_defaults=True):
    """One line; exactly one of the members is present."""

    head: JournalHead | None = None
    session: Session | None = None
    result: CaseResult | None = None
    lost_attempt: LostAttempt | None = None


@dataclass(slots=True)
class JournalContent:
    """Parsed content of a journal."""

    head: JournalHead | None = None
    sessions: list[Session] = field(default_factory=list)
    results: list[CaseResult] = field(default_factory=list)
    """Results as written: a case may have several."""
    lost_attempts: list[LostAttempt] = field(default_factory=list)
    damaged: list[int] = field(default_factory=list)
    """Numbers of the damaged lines, from 1."""
    whole_bytes: int = 0
    """Length up to the end of the last complete line; a torn line may follow."""


class JournalDamageError(EngineError):
    """Some lines of the journal are damaged; the text gives their numbers."""


_encode: Final = msgspec.json.Encoder().encode
_decode: Final = msgspec.json.Decoder(JournalLine).decode


def encode_line(line: JournalLine) -> bytes:
    body = _encode(line)
    assert body.startswith(b"{")
    return _OPENING + _sum(body[1:]) + b'",' + body[1:] + b"\n"


def decode_line(text: bytes) -> JournalLine | None:
    """Decode one line, given without its end; None if it is damaged."""
    body = text[_BODY_FROM:]
    if not text.startswith(_OPENING) or text[:_BODY_FROM] != _OPENING + _sum(body) + b'",':
        return None
    try:
        return _decode(b"{" + body)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None


def _sum(body: bytes) -> bytes:
    return hashlib.blake2b(body, digest_size=_SUM_DIGITS // 2).hexdigest().encode("ascii")


def parse_journal(data: bytes) -> JournalContent:
    """Parse any bytes; damaged and torn lines are reported, never guessed."""
    content = JournalContent(whole_bytes=data.rfind(b"\n") + 1)
    for number, text in enumerate(data[: content.whole_bytes].split(b"\n")[:-1], start=1):
        line = decode_line(text)
        if line is None:
            content.damaged.append(number)
        elif line.head is not None:
            content.head = content.head or line.head
        elif line.session is not None:
            content.sessions.append(line.session)
        elif line.result is not None:
            content.results.append(line.result)
        elif line.lost_attempt is not None:
            content.lost_attempts.append(line.lost_attempt)
    return content


def read_journal(path: Path) -> JournalContent:
    """Read what is written until now, even while another process writes; empty without a file."""
    try:
        return parse_journal(path.read_bytes())
    except FileNotFoundError:
        return JournalContent()
    except OSError as error:
        raise EngineError(f"{path}: cannot be read: {error.strerror}") from error


def refuse_damage(path: Path, content: JournalContent) -> None:
    """Raises JournalDamageError if the journal holds a damaged line."""
    if content.damaged:
        lines = ", ".join(str(number) for number in content.damaged)
        raise JournalDamageError(
            f"{path}: line {lines}: damaged; `hil resume` runs its cases again"
        )


class Journal:
    """A journal open for writing. A lock admits only one process at a time."""

    def __init__(self, path: Path, head: JournalHead) -> None:
        """Open or create the journal; cut off a torn end and leave out damaged lines.

        The file with the damaged lines is kept as `journal.damaged`.

        Raises:
            EngineError: if another process has the journal, it belongs to another campaign, or the
                disk refuses.
        """
        self._path = path
        self.left_out = 0
        """Number of damaged lines that were left out; their cases have no result any more."""
        self._clock = WallClock()
        self._lock = _lock(path.with_suffix(".lock"))
        self._file = -1
        self._synced_ns, self._unsynced = self._clock.now_ns(), False
        try:
            self.found = self._open(head)
        except BaseException:
            self.close()
            raise

    def _open(self, head: JournalHead) -> JournalContent:
        found = read_journal(self._path)
        self.left_out = len(found.damaged)
        if found.head is not None and found.head != head:
            raise EngineError(
                f"{self._path}: belongs to another campaign (fingerprint {found.head.fingerprint}, "
                f"not {head.fingerprint})"
            )
        try:
            if found.damaged:
                _rewrite(self._path, head, found)
                found = read_journal(self._path)
            self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
            if os.fstat(self._file).st_size != found.whole_bytes:
                os.ftruncate(self._file, found.whole_bytes)
            if found.head is None:
                self._write(JournalLine(head=head))
                found.head = head
            os.fsync(self._file)
        except OSError as error:
            raise EngineError(f"{self._path}: {error.strerror}") from error
        return found

    def _write(self, line: JournalLine) -> None:
        data = encode_line(line)
        while data:
            data = data[os.write(self._file, data) :]

    def append(self, entry: CaseResult | LostAttempt | Session) -> None:
        """Write one line. Raises EngineError if the disk refuses."""
        if isinstance(entry, CaseResult):
            line = JournalLine(result=entry)
        elif isinstance(entry, LostAttempt):
            line = JournalLine(lost_attempt=entry)
        else:
            line = JournalLine(session=entry)
        try:
            self._write(line)
            self._unsynced = True
            self.sync()
        except OSError as error:
            raise EngineError(f"{self._path}: {error.strerror}") from error

    def sync(self, at_once: bool = False) -> None:
        """Flush to the disk, unless the last flush is less than `SYNC_S` ago."""
        now_ns = self._clock.now_ns()
        if self._unsynced and (at_once or now_ns - self._synced_ns >= SYNC_S * NS_PER_S):
            os.fsync(self._file)
            self._unsynced = False
            self._synced_ns = self._clock.now_ns()

    def close(self) -> None:
        """Flush and release the lock, even on failure. Raises EngineError if the disk refuses."""
        file, lock, self._lock = self._file, self._lock, -1
        try:
            if file >= 0:
                self.sync(at_once=True)
        except OSError as error:
            raise EngineError(f"{self._path}: {error.strerror}") from error
        finally:
            self._file = -1
            for each in (file, lock):
                if each >= 0:
                    os.close(each)


def _lock(path: Path) -> int:
    """Lock that the kernel releases when it is closed or the process ends in any way."""
    try:
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise EngineError(f"{path}: {error.strerror}") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(lock)
        raise EngineError(f"{path.parent}: another process is running this campaign") from error
    return lock


def _rewrite(path: Path, head: JournalHead, found: JournalContent) -> None:
    """Move the damaged file aside, and write a journal of the good lines in its place."""
    lines: list[JournalLine] = [JournalLine(head=head)]
    lines += [JournalLine(session=session) for session in found.sessions]
    lines += [JournalLine(lost_attempt=attempt) for attempt in found.lost_attempts]
    lines += [JournalLine(result=result) for result in found.results]
    write_whole(path.with_suffix(".damaged"), path.read_bytes())
    write_whole(path, b"".join(encode_line(line) for line in lines))


def same_result(one: CaseResult, other: CaseResult) -> bool:
    """Whether two results are equal, apart from what depends on the host."""
    return without_host(one) == without_host(other)


def without_host(result: CaseResult) -> dict[str, Any]:
    plain: dict[str, Any] = msgspec.to_builtins(result)
    del plain["host"]
    return plain


def once_each(results: Iterable[CaseResult]) -> dict[str, CaseResult]:
    """Results by case id, in the campaign's order; the first of several for one case counts."""
    by_id: dict[str, CaseResult] = {}
    for result in results:
        by_id.setdefault(result.case_id, result)
    return dict(sorted(by_id.items(), key=lambda item: (item[1].index, item[0])))
