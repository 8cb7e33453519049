"""Every command ends cleanly: on Ctrl-C, on a full disk, and without a reader of its output."""

import json
import subprocess
import sys
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Final

import pytest

from canlog.command import VERBS as CANLOG
from metro_hil.cli.hil import VERBS as HIL
from metro_hil.model.run_options import LINE_VERBS, OTHER_VERBS, SHIPPED_VERBS

ROOT: Final = Path(__file__).resolve().parents[2]
SCRIPTS: Final[Mapping[str, str]] = tomllib.loads(
    (ROOT / "pyproject.toml").read_text(encoding="utf-8")
)["project"]["scripts"]
VERBS: Final[Mapping[str, Sequence[str]]] = {
    "vobc": ("run", *OTHER_VERBS, *SHIPPED_VERBS, *LINE_VERBS),
    "plant": ("run", "consists", "desk", "wayside"),
    "hil": tuple(HIL),
    "vcan": ("up", "down", "status"),
    "vcan-guest": (),
    "canlog": tuple(CANLOG),
}
SHOWING: Final = {
    "vobc": (["lines"], ["consists"], ["show", "line", "florence"]),
    "plant": (["consists"],),
    "hil": (
        ["scenarios"],
        ["monitors"],
        ["faults"],
        ["requirements"],
        ["laws"],
        ["check", "smoke"],
    ),
    "vcan": (["status"], ["up", "--kind", "embedded", "--dry-run"]),
}
"""Commands that print and need no input, in addition to the help of every verb."""
LOSSES: Final = {
    "full": "No space left on device",
    "left": "Broken pipe",
    "closed": "closed",
}
MINUTES_S: Final = 240


def commands(program: str) -> list[list[str]]:
    return [["--help"], *([verb, "--help"] for verb in VERBS[program])]


@cache
def ends_of(program: str) -> Mapping[tuple[str, str], tuple[int, list[str]]]:
    """Exit code and standard error of each command of a program, by condition and arguments."""
    asked = [
        (condition, words)
        for condition in ("plain", "interrupt", "full", "left", "closed", "ascii")
        for words in [*commands(program), *SHOWING.get(program, ())]
    ]
    done = subprocess.run(
        [sys.executable, "-m", "hil_tests.contract.ends_driver", SCRIPTS[program]],
        input=json.dumps(asked),
        capture_output=True,
        text=True,
        timeout=MINUTES_S,
        cwd=ROOT,
        check=True,
    )
    found = json.loads(done.stdout)
    return {
        (condition, " ".join(words)): (code, lines)
        for (condition, words), (code, lines) in zip(asked, found, strict=True)
    }


def wrong(program: str, condition: str, code: int, words: str) -> list[str]:
    """The commands of a program that end differently under a condition."""
    return [
        f"{program} {command}: {found}: {lines}"
        for (where, command), (found, lines) in ends_of(program).items()
        if where == condition
        and not (found == code and len(lines) == 1 and lines[0] == f"{program}: {words}")
    ]


@pytest.mark.parametrize("program", sorted(SCRIPTS))
def test_the_tested_commands_are_complete(program: str) -> None:
    """The commands must also succeed without a condition, so that the tests below find real
    faults."""
    plain = {command: end for (where, command), end in ends_of(program).items() if where == "plain"}

    assert {command: end for command, end in plain.items() if end != (0, [])} == {}
    done = subprocess.run(
        [Path(sys.executable).parent / program, "--help"],
        capture_output=True, text=True, timeout=MINUTES_S, check=True,
    )  # fmt: skip
    assert [verb for verb in VERBS[program] if verb not in done.stdout] == []


@pytest.mark.parametrize("program", sorted(SCRIPTS))
def test_ctrl_c_ends_every_command_with_one_line_and_exit_code_130(program: str) -> None:
    assert wrong(program, "interrupt", 130, "ended by Ctrl-C") == []


@pytest.mark.parametrize("condition", LOSSES)
@pytest.mark.parametrize("program", sorted(SCRIPTS))
def test_a_lost_standard_output_ends_every_command_with_one_line_and_exit_code_3(
    program: str, condition: str
) -> None:
    words = f"standard output: {LOSSES[condition]}; the rest of the output is lost"

    assert wrong(program, condition, 3, words) == []


@pytest.mark.parametrize("program", sorted(SCRIPTS))
def test_an_ascii_terminal_causes_no_traceback_of_any_command(program: str) -> None:
    for (condition, command), (code, lines) in ends_of(program).items():
        if condition == "ascii":
            told = [line for line in lines if "ascii cannot show" in line]
            assert (code, lines) == (3 if told else 0, told), f"{program} {command}"
