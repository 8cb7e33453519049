"""A program that a warm server forks does what the program does that starts by itself."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from metro_tools.warm.programs import PROGRAMS, REAL, warm_programs

KEPT = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
ENVIRONMENT = {**KEPT, "VOBC_NATIVE": "wire", "COLUMNS": "120"}


@pytest.fixture(scope="module")
def venv(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """An environment with the libraries of this one, whose programs are warm."""
    here = Path(sys.executable).parent.parent
    venv = tmp_path_factory.mktemp("warm") / "venv"
    (venv / "bin").mkdir(parents=True)
    (venv / "lib").symlink_to(here / "lib")
    shutil.copy(here / "pyvenv.cfg", venv)
    (venv / "bin" / "python").symlink_to(Path(sys.executable).resolve())
    for name in PROGRAMS:
        _, _, text = (here / "bin" / name).read_text(encoding="utf-8").partition("\n")
        (venv / "bin" / name).write_text(f"#!{venv}/bin/python\n{text}", encoding="utf-8")
        (venv / "bin" / name).chmod(0o755)
    with warm_programs(venv, ENVIRONMENT, None, venv.parent):
        yield venv


def started(
    script: Path, words: Sequence[str], folder: Path, **more: str
) -> "subprocess.CompletedProcess[bytes]":
    return subprocess.run(
        [str(script), *words],
        cwd=folder,
        env={**ENVIRONMENT, **more},
        input=b"",
        capture_output=True,
        check=False,
    )


@pytest.mark.parametrize(
    ("program", "words", "status"),
    [
        ("vobc", ("check", "--line", "florence"), 0),
        ("vobc", ("check", "--line", "none.toml"), 2),
        ("hil", ("check", "smoke"), 0),
        ("hil", ("run", "--limit", "0"), 2),
        ("canlog", ("show", "no-such-log"), 2),
        ("plant", ("--help",), 0),
    ],
)
def test_a_warm_program_prints_and_returns_the_same(
    venv: Path, tmp_path: Path, program: str, words: tuple[str, ...], status: int
) -> None:
    real = started(venv / REAL / program, words, tmp_path)
    warm = started(venv / "bin" / program, words, tmp_path)

    assert real.returncode == status, real.stderr
    assert (warm.returncode, warm.stdout, warm.stderr) == (
        real.returncode,
        real.stdout,
        real.stderr,
    )


def test_a_warm_program_is_a_fork(venv: Path, tmp_path: Path) -> None:
    """A launcher whose server refuses could not execute this file."""
    (venv / REAL / "hil").chmod(0o644)
    try:
        assert started(venv / "bin" / "hil", ("--version",), tmp_path).returncode == 0
    finally:
        (venv / REAL / "hil").chmod(0o755)


def test_a_warm_program_writes_the_same_files(venv: Path, tmp_path: Path) -> None:
    words = ("run", "--lockstep", "--from", "II", "--to", "III", "--duration", "3", "--no-plot")
    for place in (REAL, "bin"):
        done = started(venv / place / "vobc", (*words, "--out", place), tmp_path)
        assert done.returncode == 0, done.stderr

    one, other = ((tmp_path / place / "bus.log").read_bytes() for place in (REAL, "bin"))
    assert one == other


def test_a_program_with_another_environment_starts_by_itself(venv: Path, tmp_path: Path) -> None:
    """VOBC_NATIVE decides during imports, which a warm server has behind it."""
    words = ("--version", "-v")

    real = started(venv / REAL / "vobc", words, tmp_path, VOBC_NATIVE="off")
    warm = started(venv / "bin" / "vobc", words, tmp_path, VOBC_NATIVE="off")

    assert b"VOBC_NATIVE=off" in real.stdout
    assert warm.stdout == real.stdout


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_signal_to_the_launcher_ends_the_program(
    venv: Path, tmp_path: Path, number: signal.Signals
) -> None:
    words = ("run", "--lockstep", "--desk", "manual", "--driver", "reckless", "--duration", "9e3")
    with subprocess.Popen(
        [str(venv / "bin" / "vobc"), *words, "--no-plot", "--out", "run"],
        cwd=tmp_path,
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    ) as launcher:
        while not (tmp_path / "run" / "bus.log").exists():
            assert launcher.poll() is None
        launcher.send_signal(number)
        # The pipe ends when the program has ended, too.
        output = launcher.stdout.read() if launcher.stdout is not None else b""

    assert launcher.returncode == (-number if number is signal.SIGKILL else 130), output
