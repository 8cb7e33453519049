"""The folder of a campaign: its manifest, cases, files, journal and kept logs under fixed names."""

import hashlib
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import msgspec

from firmware_py.clock.clock import WallClock
from firmware_py.settings import nearest
from firmware_py.storage.whole_file import write_whole
from metro_hil.engine.errors import EngineError, UsageError
from metro_hil.engine.journal import JournalHead
from metro_hil.engine.program import program_version
from metro_hil.model.case import Case, subset_text
from metro_hil.model.run_folder import RunFolder, utc_text, versions

ROOT: Final = Path("runs/hil")
MANIFEST: Final = "campaign.json"
NAME_BYTES_MAX: Final = 120
PLAIN_CHARACTERS: Final = " =,+@()"
HASH_DIGITS: Final = 16


class FileEntry(msgspec.Struct, frozen=True):
    """A file of the user, copied into the campaign's folder."""

    path: str
    """Path relative to the campaign's folder."""
    sha256: str


class Manifest(msgspec.Struct, frozen=True, kw_only=True):
    """Describes the campaign. It is written once, before any case runs."""

    name: str
    title: str = ""
    description: str = ""
    layout: str | None = None
    fingerprint: str
    """Hash over cases, files and program; equal fingerprints mean equal campaigns."""
    cases: int
    planned_cases: int = 0
    """Number of cases of the whole campaign; more than `cases` where only some were selected."""
    cases_sha256: str
    files: dict[str, FileEntry] = {}
    """File entries, by the name by which cases refer to the file."""
    started: str
    """Start of the campaign in UTC."""
    program: str
    versions: dict[str, str]
    options: dict[str, Any] = {}
    """Options as given to `hil run`."""

    @property
    def subset(self) -> str:
        """Text such as `3 of 8 cases`; empty where all cases of the campaign were selected."""
        return subset_text(self.cases, self.planned_cases)


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignPlan:
    """All inputs from which a campaign folder is made."""

    name: str
    cases: Sequence[Case]
    title: str = ""
    description: str = ""
    layout: str | None = None
    planned_cases: int = 0
    """Number of cases of the whole campaign, if `cases` is only a part of it."""
    files: Mapping[str, str]
    """File contents, by the name by which cases refer to the file."""
    options: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class CampaignFolder:
    """Paths and contents of one campaign's folder."""

    path: Path

    @property
    def manifest_path(self) -> Path:
        return self.path / MANIFEST

    @property
    def cases_path(self) -> Path:
        return self.path / "cases.jsonl"

    @property
    def journal_path(self) -> Path:
        return self.path / "journal.jsonl"

    def kept(self, case_id: str) -> RunFolder:
        """Folder of the logs of one case, if they were kept: below `cases/`, named by the case
        id."""
        parts = (folder_name(part) for part in case_id.split("/"))
        return RunFolder(self.path.joinpath("cases", *parts))

    def manifest(self) -> Manifest:
        """Read the manifest. Raises EngineError if it is missing or unreadable."""
        data = _read(self.manifest_path)
        try:
            return msgspec.json.decode(data, type=Manifest)
        except msgspec.DecodeError as error:
            raise EngineError(f"{self.manifest_path}: {error}") from error

    def cases(self) -> tuple[Case, ...]:
        """Read the cases. Raises EngineError if they are not those that the manifest names."""
        data = _read(self.cases_path)
        if _sha256(data) != self.manifest().cases_sha256:
            raise EngineError(f"{self.cases_path}: not the cases that {MANIFEST} names")
        try:
            return tuple(msgspec.json.Decoder(Case).decode_lines(data))
        except msgspec.DecodeError as error:
            raise EngineError(
                f"{self.cases_path}: written by version {self.manifest().program} of the program, "
                f"which does not record what its cases claim; run the campaign again"
            ) from error

    def files(self) -> dict[str, Path]:
        """Paths by the name that cases use. Raises EngineError if a file was changed."""
        paths = {}
        for name, entry in self.manifest().files.items():
            path = self.path / entry.path
            if _sha256(_read(path)) != entry.sha256:
                raise EngineError(f"{path}: was changed since the campaign began")
            paths[name] = path.resolve()
        return paths

    def head(self) -> JournalHead:
        """The head that the journal of this campaign must have."""
        manifest = self.manifest()
        return JournalHead(manifest.fingerprint, manifest.cases)


def folder_name(words: str) -> str:
    """A valid folder name, different for each text; plain texts stay as they are."""
    name = quote(words, safe=PLAIN_CHARACTERS) or "%"
    if len(name) > NAME_BYTES_MAX:
        digits = hashlib.sha256(words.encode()).hexdigest()[:HASH_DIGITS]
        name = f"{name[: NAME_BYTES_MAX - HASH_DIGITS - 1]}~{digits}"
    return name.replace(".", "%2E") if set(name) <= {"."} else name


def make_folder(plan: CampaignPlan, out: str | None = None, root: Path = ROOT) -> CampaignFolder:
    """Create a new folder with everything but the journal.

    Raises:
        UsageError: if there is no case, a case cannot be stored, or `out` is not empty.
        EngineError: if the disk refuses.
    """
    if not plan.cases:
        raise UsageError(f"{plan.name}: there is no case to run")
    lines = _cases_text(plan.cases)
    now_ns = WallClock().epoch_ns()
    stamp = utc_text(now_ns)
    path = Path(out) if out else _free(root / f"{stamp.replace(':', '-')}_{folder_name(plan.name)}")
    folder = CampaignFolder(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            raise UsageError(
                f"--out {path}: not empty; to continue a campaign use `hil resume {path}`"
            )
        entries = {
            name: _copy(path, number, name, content.encode())
            for number, (name, content) in enumerate(sorted(plan.files.items()))
        }
        write_whole(folder.cases_path, lines)
        hashes = {name: entry.sha256 for name, entry in entries.items()}
        manifest = Manifest(
            name=plan.name,
            title=plan.title,
            description=plan.description,
            layout=plan.layout,
            fingerprint=fingerprint(lines, hashes, program_version()),
            cases=len(plan.cases),
            planned_cases=plan.planned_cases,
            cases_sha256=_sha256(lines),
            files=entries,
            started=f"{stamp}Z",
            program=program_version(),
            versions=versions(),
            options=dict(plan.options),
        )
        text = msgspec.json.format(msgspec.json.encode(manifest), indent=2)
        write_whole(folder.manifest_path, text + b"\n")
    except OSError as error:
        raise EngineError(f"{path}: cannot be written: {error.strerror}") from error
    return folder


def fingerprint(cases: bytes, file_hashes: Mapping[str, str], program: str) -> str:
    """Hash that is equal for two campaigns with equal cases, file contents and program."""
    parts = (_sha256(cases), sorted(file_hashes.items()), program)
    return _sha256(msgspec.json.encode(parts))[:HASH_DIGITS]


def fingerprint_of(cases: Sequence[Case], files: Mapping[str, str]) -> str:
    """Fingerprint that the folder of these cases and files would get. Raises UsageError."""
    hashes = {name: _sha256(content.encode()) for name, content in files.items()}
    return fingerprint(_cases_text(cases), hashes, program_version())


def _cases_text(cases: Sequence[Case]) -> bytes:
    """One line for each case. Raises UsageError for a value that JSON would not give back."""
    pieces = []
    ids: set[str] = set()
    for index, case in enumerate(cases):
        assert case.index == index, "cases are numbered without gaps"
        if case.id in ids:
            raise UsageError(f"{case.id}: two cases have this id")
        ids.add(case.id)
        piece = msgspec.json.encode(case)
        again = msgspec.json.decode(piece, type=Case)
        # JSON turns some values, such as infinity, into null; MessagePack keeps them.
        if msgspec.msgpack.encode(again) != msgspec.msgpack.encode(case):
            raise UsageError(f"{case.id}: a value is infinite, not a number or a date")
        pieces.append(piece + b"\n")
    return b"".join(pieces)


def find_folder(name: str | None, root: Path = ROOT) -> CampaignFolder:
    """Find a campaign by path, full name, unique beginning, or campaign name; None means the last.

    A campaign name stands for the last run of that campaign. Raises UsageError when there is none
    or more than one.
    """
    if name is not None and (Path(name) / MANIFEST).is_file():
        return CampaignFolder(Path(name))
    known = folders(root)
    if name is None:
        if not known:
            raise UsageError(f"{root}: no campaign there; `hil run` makes one")
        return known[-1]
    names = [folder.path.name for folder in known]
    matches = [folder for folder in known if folder.path.name == name]
    matches = matches or [folder for folder in known if folder.path.name.startswith(name)]
    # `hil run florence` is followed by `hil show florence`.
    matches = matches or [folder for folder in known if _ran(folder, name)][-1:]
    if len(matches) > 1:
        found = ", ".join(folder.path.name for folder in matches)
        raise UsageError(f"{name}: more than one campaign begins like this: {found}")
    if not known:
        raise UsageError(f"{name}: no campaign below {root}; `hil run` makes one")
    if not matches:
        raise UsageError(f"{name}: {nearest(name, names, 'campaign')}")
    return matches[0]


def folders(root: Path = ROOT) -> list[CampaignFolder]:
    """All campaigns below `root`, the oldest first. A folder without a manifest is ignored."""
    found = [CampaignFolder(path.parent) for path in root.glob(f"*/{MANIFEST}")]
    return sorted(found, key=lambda folder: (_began(folder), folder.path.name))


def _ran(folder: CampaignFolder, name: str) -> bool:
    try:
        return folder.manifest().name == name
    except EngineError:
        return False


def _began(folder: CampaignFolder) -> int:
    """Time of the manifest, which orders two campaigns that began in the same second."""
    return folder.manifest_path.stat().st_mtime_ns


def _copy(folder: Path, number: int, name: str, content: bytes) -> FileEntry:
    """Each file has its own folder, because files may share the last part of their names."""
    place = Path("files") / str(number) / folder_name(Path(name).name)
    (folder / place).parent.mkdir(parents=True)
    write_whole(folder / place, content)
    return FileEntry(str(place), _sha256(content))


def _free(path: Path) -> Path:
    number, free = 2, path
    while free.exists():
        free = path.with_name(f"{path.name}_{number}")
        number += 1
    return free


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise EngineError(f"{path}: cannot be read: {error.strerror}") from error


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def empty_run_folder(folder: RunFolder) -> RunFolder:
    """Create the folder of a run, without anything that an earlier attempt left in it."""
    shutil.rmtree(folder.path, ignore_errors=True)
    folder.path.mkdir(parents=True)
    return folder
