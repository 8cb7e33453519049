"""Finds runs below `runs/`: by a word on the command line, or the last one.

`runs/latest` is a symbolic link to the folder of the run that was started last. Each run replaces
it in one step when it starts, so that parallel runs never leave a broken link.
"""

import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Final

from canlog.damage import LogError

ROOT: Final = Path("runs")
LATEST: Final = "latest"
MARKS: Final = ("run.toml", "bus.log", "line.log", "events.jsonl")
"""A folder below `runs/` that holds one of these files is the folder of a run."""
LISTED_MAX: Final = 10


def choose_run(word: Path | str | None, program: str, root: Path = ROOT) -> Path:
    """The path that a word on the command line means; None means the last run.

    A path that exists is taken as it is. Any other word is a name of a run, its beginning, or a
    part of it. The choice is reported on standard error, because the user did not type the path.

    Raises:
        LogError: when there is no run, or when several runs match.
    """
    chosen = _find(word, root)
    if word is None or chosen != Path(word):
        print(f"{program}: reading {chosen}", file=sys.stderr)
    return chosen


def mark_latest(run: Path, root: Path = ROOT) -> None:
    """Point `runs/latest` at a run that starts now, if the folder `runs` exists.

    A run must never fail because of this link, so a folder that cannot be written is ignored.
    """
    inside = run.parent.resolve() == root.resolve()
    target = run.name if inside else str(run.resolve())
    part = root / f".{LATEST}.{os.getpid()}"
    with suppress(OSError):
        part.unlink(missing_ok=True)
        part.symlink_to(target)
        part.replace(root / LATEST)
    with suppress(OSError):
        part.unlink(missing_ok=True)


def forget_removed(root: Path = ROOT) -> None:
    """Point `runs/latest` at the newest remaining run if its run was removed."""
    link = root / LATEST
    if not link.is_symlink() or link.exists():
        return
    runs = run_folders(root)
    if runs:
        mark_latest(runs[-1], root)
    else:
        link.unlink(missing_ok=True)


def run_folders(root: Path = ROOT) -> list[Path]:
    """All run folders directly below `runs/`, the most recently started one last."""
    if not root.is_dir():
        return []
    found = [
        (started, path.name, path)
        for path in root.iterdir()
        if path.name != LATEST and (started := _started_ns(path)) is not None
    ]
    return [path for _, _, path in sorted(found)]


def _started_ns(path: Path) -> int | None:
    """When the first existing mark file of a run was written; None if there is none."""
    for name in MARKS:
        with suppress(OSError):
            return (path / name).stat().st_mtime_ns
    return None


def _find(word: Path | str | None, root: Path) -> Path:
    if word is None:
        return _latest(root)
    path = Path(word)
    if path.name == LATEST and path.is_symlink():
        return path.parent / path.readlink()
    text = str(word).rstrip("/").removeprefix(f"{root}/")
    if path.exists() or "/" in text:
        return path
    if text == LATEST:
        return _latest(root)
    runs = run_folders(root)
    matches = [run for run in runs if run.name == text]
    matches = matches or [run for run in runs if run.name.startswith(text)]
    matches = matches or [run for run in runs if text in run.name]
    if len(matches) > 1:
        raise LogError(
            f"{text}: {len(matches)} runs match; write more of one name\n{_listed(matches)}"
        )
    if not matches and "." not in text:
        raise LogError(f"{text}: no such file, and no run below {root}/ has that in its name")
    return matches[0] if matches else path


def _latest(root: Path) -> Path:
    link = root / LATEST
    if link.is_symlink() and link.exists():
        return root / link.readlink()
    runs = run_folders(root)
    if not runs:
        raise LogError(f"{root}: no run there; name a folder, or make one with `vobc run`")
    return runs[-1]


def _listed(runs: list[Path]) -> str:
    names = [f"  {run.name}" for run in reversed(runs[-LISTED_MAX:])]
    more = len(runs) - len(names)
    return "\n".join([*names, *([f"  and {more} older ones"] if more else [])])
