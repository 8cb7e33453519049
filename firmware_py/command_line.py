"""The parser of every command: version, shell completion, and short answers to a typo."""

import argparse
import difflib
import re
import sys
from collections.abc import Iterable
from typing import Any, Final, NoReturn

from firmware_py import __version__

SHELLS: Final = ("bash", "zsh", "fish")
"""Shells that `--completion` writes a script for."""
NEAR_RATIO: Final = 0.6
"""Least similarity of a suggestion to the typed word, as difflib measures it."""
CHOICES_LISTED_MAX: Final = 9
"""An error lists at most so many choices; a longer list is left to --help."""
OPTIONAL_PART: Final = re.compile(r"\[-[^\[\]]*(?:\[[^\[\]]*\][^\[\]]*)*\] ?")
"""An option in brackets in argparse's usage, with a bracket inside at most."""


class CommandParser(argparse.ArgumentParser):
    """Answers a mistake with two lines: what is wrong, with the nearest name, and the usage.

    Parsers of verbs are of this class, too, as `add_subparsers` takes the class of its parser.
    """

    def __init__(self, *args: Any, is_command: bool = False, **kwargs: Any) -> None:
        """Args:
        is_command: adds `--version` and `--completion`; for a whole command, not for a verb.
        """
        super().__init__(*args, **kwargs)
        if is_command:
            name = self.prog.removeprefix("python -m ")
            self.add_argument(
                "--version",
                action="version",
                version=f"{name} {__version__}",
                help="print the version and exit",
            )
            self.add_argument(
                "--completion",
                action=_PrintCompletion,
                dest=argparse.SUPPRESS,
                default=argparse.SUPPRESS,
                choices=SHELLS,
                metavar="SHELL",
                help="print a completion script for bash, zsh or fish and exit",
            )

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Refuse unknown words here, where the options of the verb are known.

        A wrong first option is refused before argparse complains of a missing argument.
        """
        words = sys.argv[1:] if args is None else list(args)
        if words and words[0].startswith("--") and not self._is_known(words[0]):
            self.error(self._of_unknown(words[:1]))
        options, rest = super().parse_known_args(words, namespace)
        if rest:
            self.error(self._of_unknown(rest))
        return options, rest

    def error(self, message: str) -> NoReturn:
        """Print the message and one line of usage, and exit with code 2."""
        self.exit(2, f"{self.prog}: {message}\n{self._short_usage()}\n")

    def _is_known(self, word: str) -> bool:
        name = word.partition("=")[0]
        return (
            any(option.startswith(name) for option in self._option_string_actions) or word == "--"
        )

    def _of_unknown(self, words: list[str]) -> str:
        options = [word for word in words if word.startswith("-") and word != "-"]
        if not options:
            return f"unexpected argument: {' '.join(words)}"
        word = options[0].partition("=")[0]
        return f"unknown option {word}{suggestion(word, self._option_string_actions)}"

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        choices = [str(choice) for choice in action.choices]
        if isinstance(action, argparse._SubParsersAction):
            text = f"unknown verb {value!r}{suggestion(str(value), choices)}"
            raise argparse.ArgumentError(None, text)
        listed = f" (choose from {', '.join(choices)})" * (len(choices) <= CHOICES_LISTED_MAX)
        text = f"invalid choice: {value!r}{suggestion(str(value), choices)}{listed}"
        raise argparse.ArgumentError(action, text)

    def _short_usage(self) -> str:
        """Argparse's usage in one line, all optional options as one word."""
        usage = " ".join(self.format_usage().split())
        if self.usage is None:
            short = OPTIONAL_PART.sub("", usage).rstrip()
            usage = short.replace(self.prog, f"{self.prog} [OPTION ...]", 1)
        return f"{usage}; `{self.prog} --help` explains all"


def suggestion(word: str, names: Iterable[str]) -> str:
    """A question with the name nearest to `word`, or nothing where none is near."""
    near = difflib.get_close_matches(word, list(names), n=1, cutoff=NEAR_RATIO)
    return f"; did you mean {near[0]}?" if near else ""


class _PrintCompletion(argparse.Action):
    """Prints a completion script for the whole parser that the option stands in."""

    def __call__(self, parser: argparse.ArgumentParser, *args: Any, **kwargs: Any) -> None:
        import shtab

        _name_files(parser)
        (shell,) = (word for word in args if word in SHELLS)
        print(shtab.complete(parser, shell))
        parser.exit()


def _name_files(parser: argparse.ArgumentParser) -> None:
    """Let the shell complete files and folders, by what the help calls each argument."""
    import shtab

    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                _name_files(verb)
        elif action.choices is None and isinstance(action.metavar, str):
            if "FILE" in action.metavar or action.metavar in ("LOG", "RUN"):
                action.complete = shtab.FILE  # type: ignore[attr-defined]
            elif action.metavar in ("FOLDER", "DIRECTORY"):
                action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
