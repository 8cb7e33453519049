"""Writes docs/reference/commands.md: every command with its verbs and options, from its parser."""

import argparse
import sys
from collections.abc import Iterator, Sequence
from typing import Final

from canlog import command as canlog_command
from metro_hil.cli import hil as hil_command
from metro_hil.cli.whole_parser import verbs_of, whole_parser
from metro_tools import vcan
from metro_tools.generated_doc import markdown_table, write_or_check
from metro_tools.guest import cli as guest_command
from plant_emulator.cli import options as plant_options

DOCUMENT: Final = "docs/reference/commands.md"
MODULE: Final = "metro_tools.command_doc"
OPENING: Final = f"""\
# Commands

Generated from the parsers of the commands by `python -m {MODULE}` (`make docs`).

Every command has `--help`, `--version` and `--completion SHELL`. It answers a mistake in two lines,
with the nearest verb or option. To switch completion on, write the script once to the place where
the shell looks for it, for each command:

| shell | command |
| --- | --- |
| bash | `vobc --completion bash > ~/.local/share/bash-completion/completions/vobc` |
| zsh | `vobc --completion zsh > FOLDER/_vobc`, with a folder of `$fpath` |
| fish | `vobc --completion fish > ~/.config/fish/completions/vobc.fish` |

[How commands end](endings.md) has the exit codes.
"""


def document() -> str:
    """The whole page."""
    return "\n".join([OPENING, *(text for parser in _parsers() for text in _command(parser))])


def _parsers() -> Iterator[argparse.ArgumentParser]:
    yield whole_parser()
    yield plant_options.parser()
    yield hil_command.parser()
    yield canlog_command.parser()
    yield vcan.parser()
    yield guest_command.parser()


def _command(parser: argparse.ArgumentParser) -> Iterator[str]:
    yield f"## {parser.prog.removeprefix('python -m ')}\n"
    verbs = verbs_of(parser)
    if not verbs:
        yield from _verb(parser)
        return
    yield f"{_sentence(parser.description)}\n"
    for verb in verbs.values():
        for each in (verb, *verbs_of(verb).values()):
            yield f"### {each.prog}\n"
            yield from _verb(each)


def _verb(parser: argparse.ArgumentParser) -> Iterator[str]:
    yield f"{_sentence(parser.description)}\n"
    positional = [each for each in parser._actions if not each.option_strings]
    options = [each for each in parser._actions if each.option_strings]
    rows = [
        (_names(parser, each), _help(parser, each))
        for each in (*positional, *options)
        if each.help != argparse.SUPPRESS and each.dest not in ("help", argparse.SUPPRESS)
    ]
    if rows:
        yield markdown_table(("argument", "what"), rows)


def _names(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    """As it is typed, with the name of its value."""
    value = ""
    if action.nargs != 0:
        shown = action.metavar or action.dest.upper()
        value = shown if isinstance(shown, str) else " ".join(shown)
        if action.choices is not None and action.metavar is None:
            value = "{" + ",".join(map(str, action.choices)) + "}"
    names = ", ".join(action.option_strings)
    return f"`{f'{names} {value}'.strip()}`".replace("|", "\\|")


def _help(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    """With its defaults filled in, as --help has it."""
    text = (action.help or "") % {**vars(action), "prog": parser.prog}
    return " ".join(text.split()).replace("|", "\\|")


def _sentence(text: str | None) -> str:
    """A description as one paragraph."""
    words = " ".join((text or "").split())
    if not words:
        return "See `--help`."
    return words[0].upper() + words[1:] + ("" if words.endswith((".", ":")) else ".")


def main(argv: Sequence[str] | None = None) -> int:
    """Write the page, or with --check only say whether it is current."""
    return write_or_check(
        argv, module=MODULE, description=__doc__, default_path=DOCUMENT, document=document
    )


if __name__ == "__main__":
    sys.exit(main())
