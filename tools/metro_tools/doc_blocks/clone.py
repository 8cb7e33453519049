"""A fresh clone of the project with its own environment, created in seconds.

The environment shares the installed libraries of the present one, but every program in it imports
the packages of the clone.
"""

import shutil
import subprocess
import sys
import sysconfig
import tomllib
from pathlib import Path
from typing import Final

VENV: Final = ".venv"
MADE: Final = (".ready-to-run", ".ready-to-test")
"""Files by which the Makefile recognises a complete environment."""


class CloneError(Exception):
    """There is no repository to clone; the text says so."""


def make_clone(source: Path, target: Path) -> None:
    """Clone the committed files, and add uncommitted changes and new files. Raises CloneError."""
    try:
        _git(source.parent, "clone", "--quiet", "--shared", str(source), str(target))
        changed = _git(source, "diff", "--name-only", "--no-renames", "-z", "HEAD")
        new = _git(source, "ls-files", "--others", "--exclude-standard", "-z")
    except (OSError, subprocess.CalledProcessError) as error:
        said = getattr(error, "stderr", None) or error
        raise CloneError(f"{source}: cannot be cloned by git: {said}".strip()) from error
    for name in (changed + new).split("\0"):
        if name and (source / name).exists():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source / name, target / name)
        elif name:
            (target / name).unlink(missing_ok=True)
    _make_environment(target)


def _git(folder: Path, *words: str) -> str:
    done = subprocess.run(  # noqa: S603
        ["git", *words],  # noqa: S607
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout


def _make_environment(clone: Path) -> None:
    venv = clone / VENV
    subprocess.run(  # noqa: S603
        [sys.executable, "-m", "venv", "--without-pip", str(venv)], check=True, capture_output=True
    )
    ours = sysconfig.get_paths()["purelib"]
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    packages = venv / "lib" / version / "site-packages"
    # The files are processed by name: the clone's packages come before those of the other
    # environment.
    folders = "".join(f"{folder}\n" for folder in _source_folders(clone))
    (packages / "a_clone.pth").write_text(folders, encoding="utf-8")
    libraries = f"import site; site.addsitedir({ours!r})\n"
    (packages / "b_libraries.pth").write_text(libraries, encoding="utf-8")
    for script in Path(sys.executable).parent.iterdir():
        _adopt(script, venv / "bin" / script.name, venv / "bin" / "python")
    for name in MADE:
        (venv / name).touch()


def _source_folders(clone: Path) -> list[Path]:
    """Return the folders of the packages, from the settings of the wheel."""
    settings = tomllib.loads((clone / "pyproject.toml").read_text(encoding="utf-8"))
    packages = settings["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    return list(dict.fromkeys(clone / Path(package).parent for package in packages))


def _adopt(script: Path, copy: Path, python: Path) -> None:
    """Copy a console script so that the clone's Python runs it; skip all other files."""
    if copy.exists() or not script.is_file():
        return
    content = script.read_bytes()
    first, newline, rest = content.partition(b"\n")
    if first.startswith(b"#!") and b"python" in first and newline:
        copy.write_bytes(b"#!" + str(python).encode() + b"\n" + rest)
        copy.chmod(0o755)
