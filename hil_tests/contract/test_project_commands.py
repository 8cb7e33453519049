"""Commands in the documents exist, and no program runs without its asserts."""

import contextlib
import importlib
import io
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Final
from unittest import mock

import pytest

from firmware_py import __version__
from metro_hil.cli.whole_parser import verbs_of, whole_parser
from metro_hil.model.run_options import LINE_VERBS, OTHER_VERBS, SERVICE_VERBS

ROOT: Final = Path(__file__).resolve().parents[2]
BIN: Final = Path(sys.executable).parent
PROJECT: Final = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
SCRIPTS: Final = PROJECT["scripts"]
DOCUMENTS: Final = sorted([ROOT / "README.md", *ROOT.glob("docs/**/*.md")])
SECONDS: Final = 60

FENCE: Final = re.compile(r"^```(?:sh|bash|console|shell)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SPAN: Final = re.compile(r"`([^`\n]+)`")
TARGET: Final = re.compile(r"^([a-z][a-z-]*):", re.MULTILINE)


def command_lines(text: str) -> Iterator[str]:
    """Lines of shell blocks and code spans that begin with a program or file of this project."""
    heads = {*SCRIPTS, "make", ".ci/run"}
    blocks = [line for block in FENCE.findall(text) for line in block.splitlines()]
    for line in [*blocks, *SPAN.findall(FENCE.sub("", text))]:
        words = line.strip().removeprefix("$ ").split("#")[0].split()
        if words and (words[0] in heads or words[0].startswith(("tools/", ".venv/bin/"))):
            yield " ".join(words)


@cache
def help_text(program: str, verb: str) -> str:
    """The whole help text of a program, or of one of its verbs, such as `line up`.

    It runs in this process: a new process for each verb would take a minute.
    """
    module, _, function = SCRIPTS[program].partition(":")
    main = getattr(importlib.import_module(module), function).load()
    words = [program, *verb.split(), "--help"]
    said = io.StringIO()
    with mock.patch.object(sys, "argv", words), contextlib.redirect_stdout(said):
        try:
            status = main()
        except SystemExit as end:
            status = end.code
    assert status in (0, None), words
    return said.getvalue()


@pytest.mark.parametrize("name", sorted(SCRIPTS))
def test_every_console_script_names_a_function(name: str) -> None:
    module, _, function = SCRIPTS[name].partition(":")

    assert callable(getattr(importlib.import_module(module), function))
    words = [str(BIN / name), "--help"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=SECONDS, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("usage")


@pytest.mark.parametrize("name", sorted(SCRIPTS))
def test_every_command_prints_its_version(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module, _, function = SCRIPTS[name].partition(":")
    main = getattr(importlib.import_module(module), function).load()
    monkeypatch.setattr(sys, "argv", [name, "--version"])

    with pytest.raises(SystemExit) as end:
        main()

    assert end.value.code == 0
    assert capsys.readouterr().out == f"{name} {__version__}\n"


def test_the_newest_release_in_the_change_log_is_this_version() -> None:
    """The version stands in firmware_py/__init__.py alone; packaging reads it from there.

    What changed since that release stands above it, under *Unreleased*.
    """
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")

    releases = re.findall(r"^## (\S+)", text, re.MULTILINE)

    assert next(each for each in releases if each != "Unreleased") == __version__


@pytest.mark.parametrize("words", [["vobc", "tune", "--lw"], ["vobc", "run", "--lokstep"]])
def test_a_typo_in_an_option_of_any_verb_is_answered_in_two_lines(words: list[str]) -> None:
    done = subprocess.run(
        [str(BIN / words[0]), *words[1:]],
        capture_output=True,
        text=True,
        timeout=SECONDS,
        check=False,
    )

    assert done.returncode == 2
    assert "did you mean --l" in done.stderr.splitlines()[0]
    assert len(done.stderr.splitlines()) == 2


def test_completion_knows_the_options_of_every_verb() -> None:
    bare = {
        verb
        for verb, parser in verbs_of(whole_parser()).items()
        if verb in {**OTHER_VERBS, **LINE_VERBS} and not parser._option_string_actions
    }

    assert bare == set()


def fault_in(line: str) -> str | None:
    """Why a documented command would not work; None if every check passes."""
    words = [word for word in shlex.split(line) if word not in ("[", "]", "…", "...")]
    head = words[0].removeprefix(".venv/bin/")
    if head.startswith(("tools/", ".ci/")):
        return None if (ROOT / head).is_file() else f"no file {head}"
    if head == "make":
        targets = set(TARGET.findall((ROOT / "Makefile").read_text(encoding="utf-8")))
        wanted = {word for word in words[1:] if re.fullmatch(r"[a-z][a-z-]*", word)}
        return f"no target {wanted - targets}" if wanted - targets else None
    if head == "vcan-guest" and (inner := [word for word in words[1:] if word in SCRIPTS]):
        at = words.index(inner[0], 1)
        return fault_in(shlex.join(words[:at])) or fault_in(shlex.join(words[at:]))
    if head not in SCRIPTS:
        return None if (BIN / head).exists() else f"no program {head}"
    if words[:3] == ["hil", "run", "line"]:
        # A line is no campaign; `hil line --help` lists its options.
        del words[1]
    verbs = [word for word in words[1:2] if re.fullmatch(r"[a-z]+(-[a-z]+)*", word)]
    said = help_text(head, verbs[0] if verbs else "")
    if head == "vobc" and verbs == ["line"] and words[2:3] and words[2] in SERVICE_VERBS:
        said = help_text(head, f"line {words[2]}")
    options = {word.partition("=")[0] for word in words if word.startswith("--")}
    unknown = {option for option in options if not re.search(rf"(?<!\S){option}\b", said)}
    return f"no options {unknown}" if unknown else None


def test_every_documented_command_exists() -> None:
    faults = [
        f"{document.name}: {line}: {fault}"
        for document in DOCUMENTS
        for line in sorted(set(command_lines(document.read_text(encoding="utf-8"))))
        if (fault := fault_in(line)) is not None
    ]

    assert faults == []


def test_the_check_detects_wrong_commands() -> None:
    assert fault_in("make nonsense") is not None
    assert fault_in("tools/nonsense x") is not None
    assert fault_in("vcan up --nonsense") is not None
    assert fault_in("vcan-guest --nonsense vcan up") is not None
    assert fault_in("vcan-guest --vcan can7 vcan up --nonsense") is not None
    assert fault_in("vcan-guest --vcan can7 vcan up --kind kernel") is None
    assert fault_in("vcan up vcan0 --kind kernel --dry-run") is None
    assert list(command_lines("`make run`, then\n```sh\n$ vcan up  # here\nls\n```\n")) == [
        "vcan up",
        "make run",
    ]


@pytest.mark.parametrize(
    "words",
    [*([str(BIN / name)] for name in sorted(SCRIPTS)), ["-m", "vobc"], ["-m", "plant_emulator"]],
    ids=lambda words: "_".join(Path(word).name for word in words),
)
def test_an_argument_that_is_not_utf_8_is_refused_in_one_line(words: list[str]) -> None:
    """No report or configuration could name such a file."""
    done = subprocess.run(
        [sys.executable, *words, "run", b"--out=a\xff"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=SECONDS,
        check=False,
    )

    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        f"{Path(words[-1]).name.removesuffix('_emulator')}: '--out=a\\udcff': not UTF-8; "
        "give that file another name"
    ]


@pytest.mark.parametrize(
    "words",
    [
        *([str(BIN / name)] for name in sorted(SCRIPTS)),
        ["-m", "vobc"],
        ["-m", "plant_emulator"],
        ["-m", "pytest", "--collect-only", str(ROOT / "hil_tests/contract")],
    ],
    ids=lambda words: "_".join(Path(word).name for word in words[:2]),
)
def test_no_program_runs_without_its_asserts(words: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-O", *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=SECONDS,
        check=False,
    )

    assert done.returncode != 0
    assert "python -O" in done.stderr
    assert "Traceback" not in done.stderr
