"""What a command answers to a typo, its version, and its completion scripts."""

import argparse
import subprocess

import pytest

from firmware_py import __version__
from firmware_py.command_line import SHELLS, CommandParser


@pytest.fixture
def parser() -> argparse.ArgumentParser:
    top = CommandParser(prog="train", is_command=True)
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB")
    drive = verbs.add_parser("drive", help="drive it")
    drive.add_argument("line", metavar="LINE")
    drive.add_argument("--lockstep", action="store_true", help="in virtual time; 100 %% of it")
    drive.add_argument("--driver", nargs="?", metavar="MODEL", help="who drives")
    drive.add_argument("--law", choices=("green", "pid"), help="which law")
    drive.add_argument("--params", metavar="NAME|FILE", help="what it believes")
    verbs.add_parser("explain", help="say why")
    return top


def complaint(
    parser: argparse.ArgumentParser, capsys: pytest.CaptureFixture[str], *words: str
) -> list[str]:
    with pytest.raises(SystemExit) as end:
        parser.parse_args(words)
    assert end.value.code == 2
    said = capsys.readouterr()
    assert said.out == ""
    return said.err.splitlines()


@pytest.mark.parametrize(
    ("words", "first"),
    [
        (["drve", "x"], "train: unknown verb 'drve'; did you mean drive?"),
        (["qqq"], "train: unknown verb 'qqq'"),
        (["--versoin"], "train: unknown option --versoin; did you mean --version?"),
        (
            ["drive", "x", "--lokstep"],
            "train drive: unknown option --lokstep; did you mean --lockstep?",
        ),
        (["drive", "x", "--lokstep=1"], "train drive: unknown option --lokstep; did you mean"),
        (["drive", "--lokstep"], "train drive: unknown option --lokstep; did you mean"),
        (["drive", "x", "--zz"], "train drive: unknown option --zz"),
        (["drive", "x", "y", "z"], "train drive: unexpected argument: y z"),
        (["drive"], "train drive: the following arguments are required: LINE"),
        (
            ["drive", "x", "--law", "gren"],
            "train drive: argument --law: invalid choice: 'gren'; did you mean green? "
            "(choose from green, pid)",
        ),
    ],
)
def test_a_typo_is_answered_with_the_nearest_name(
    words: list[str],
    first: str,
    parser: argparse.ArgumentParser,
    capsys: pytest.CaptureFixture[str],
) -> None:
    said = complaint(parser, capsys, *words)

    assert said[0].startswith(first)
    assert len(said) == 2


def test_the_usage_is_one_line_without_the_options(
    parser: argparse.ArgumentParser, capsys: pytest.CaptureFixture[str]
) -> None:
    verb = complaint(parser, capsys, "drive")[1]
    command = complaint(parser, capsys)[1]

    assert verb == "usage: train drive [OPTION ...] LINE; `train drive --help` explains all"
    assert command == "usage: train [OPTION ...] VERB ...; `train --help` explains all"


def test_a_usage_of_its_own_is_kept(capsys: pytest.CaptureFixture[str]) -> None:
    parser = CommandParser(prog="guest", usage="guest [options] COMMAND")

    assert complaint(parser, capsys, "--zz")[1].startswith("usage: guest [options] COMMAND; ")


@pytest.mark.parametrize("words", [["drive", "x", "--lock"], ["drive", "x", "--lockstep"]])
def test_options_may_be_abbreviated(words: list[str], parser: argparse.ArgumentParser) -> None:
    assert parser.parse_args(words).lockstep


def test_a_command_has_a_version_and_a_verb_has_none(
    parser: argparse.ArgumentParser, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        parser.parse_args(["--version"])

    assert end.value.code == 0
    assert capsys.readouterr().out == f"train {__version__}\n"
    assert "unknown option --version" in complaint(parser, capsys, "drive", "x", "--version")[0]


def test_what_a_command_adds_is_no_option_of_the_verb(parser: argparse.ArgumentParser) -> None:
    assert {*vars(parser.parse_args(["explain"]))} == {"verb"}


@pytest.mark.parametrize("shell", SHELLS)
def test_a_completion_script_names_verbs_options_and_choices(
    shell: str, parser: argparse.ArgumentParser, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        parser.parse_args(["--completion", shell])
    script = capsys.readouterr().out

    assert end.value.code == 0
    assert [word for word in ("explain", "lockstep", "green") if word not in script] == []


def test_bash_completes_verbs_options_and_choices(
    parser: argparse.ArgumentParser, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        parser.parse_args(["--completion", "bash"])
    script = capsys.readouterr().out
    ask = """
    complete_it() { COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMPREPLY=(); _shtab_train
        echo "${COMPREPLY[*]}"; }
    complete_it train dr
    complete_it train drive --lo
    complete_it train drive x --law g
    """

    done = subprocess.run(
        ["bash", "-c", script + ask], capture_output=True, text=True, check=True, timeout=60
    )

    assert done.stdout.split() == ["drive", "--lockstep", "green"]
