"""The frame of every command: how it ends on Ctrl-C, on a full disk, and without standard output.

The project's commands start here. Before the signal handlers are set, this module and the console
scripts import almost nothing, because Ctrl-C in that time would print a traceback.
"""

import os
import signal
import sys

TYPE_CHECKING = False
"""Replaces the constant of `typing`, whose import would take longer than all code before the
handlers."""
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType
    from typing import NoReturn

EXIT_ENVIRONMENT = 3
EXIT_INTERRUPTED = 130
NAMES = {int(signal.SIGINT): "Ctrl-C", int(signal.SIGTERM): "SIGTERM"}
"""Signals that end a command, by the names that users know."""
STDERR = 2


class Program:
    """A command by its name. Calling it runs the command and returns its exit code."""

    def __init__(self, name: str, load: "Callable[[], Callable[[], int]]") -> None:
        """Args:
        load: imports what the command needs and returns its main function.
        """
        self.name = name
        self.load = load

    def __call__(self) -> int:
        """Run the command.

        Exit code 3 reports failures of disk and standard output, 130 Ctrl-C and SIGTERM, each with
        one line.

        A command with results to save catches the signals itself.
        """
        for number in NAMES:
            signal.signal(number, self._end_at_once)
        from firmware_py import output

        output.guard()
        main = self.load()
        for number in NAMES:
            signal.signal(number, _interrupt)
        code = self._run(main)
        if loss := output.flushed():
            self._complain(loss)
            code = code or EXIT_ENVIRONMENT
        return code

    def _run(self, main: "Callable[[], int]") -> int:
        from firmware_py.arguments import of_file

        try:
            return main()
        except SystemExit as end:
            if isinstance(end.code, str):
                print(end.code, file=sys.stderr)
                return 1
            return end.code or 0
        except KeyboardInterrupt as error:
            self._complain(f"ended by {error.args[0] if error.args else 'Ctrl-C'}")
            return EXIT_INTERRUPTED
        except OSError as error:
            self._complain(of_file(error))
            return EXIT_ENVIRONMENT
        finally:
            # While Python shuts down, a second Ctrl-C ends it without a message.
            for number in NAMES:
                signal.signal(number, signal.SIG_DFL)

    def _complain(self, text: str) -> None:
        print(f"{self.name}: {text}", file=sys.stderr, flush=True)

    def _end_at_once(self, number: int, frame: "FrameType | None") -> "NoReturn":
        """End at once.

        While modules load there is nothing to save, and a library could swallow an exception.
        """
        text = f"{self.name}: ended by {NAMES[number]} before it began\n"
        try:
            os.write(STDERR, text.encode())
        finally:
            os._exit(EXIT_INTERRUPTED)


def _interrupt(number: int, frame: "FrameType | None") -> "NoReturn":
    raise KeyboardInterrupt(NAMES[number])
