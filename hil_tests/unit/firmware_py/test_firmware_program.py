"""The frame around a command: one line and a documented exit code, however the command ends."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Final

import pytest

SECONDS: Final = 60
FRAME: Final = """\
import os, signal, sys, threading
from firmware_py.output import working
from firmware_py.program import Program

def main():
{body}

def load():
{load}
    return main

sys.exit(Program("tried", load)())
"""
FULL: Final = "tried: standard output: No space left on device; the rest of the output is lost"
CLOSED: Final = "tried: standard output: closed; the rest of the output is lost"


def tried(
    *body: str, load: str = "pass", stdout: int | str = subprocess.PIPE, **environment: str
) -> tuple[int, str, list[str]]:
    """Exit code, standard output and lines of standard error of such a command."""
    lines = "\n".join(f"    {line}" for line in body)
    script = FRAME.format(body=lines, load=f"    {load}")
    opened = os.open(stdout, os.O_WRONLY) if isinstance(stdout, str) else stdout
    done = subprocess.run(
        [sys.executable, "-c", script],
        stdout=opened,
        stderr=subprocess.PIPE,
        env={**os.environ, **environment},
        timeout=SECONDS,
        check=False,
    )
    if isinstance(stdout, str):
        os.close(opened)
    errors = done.stderr.decode("utf-8", "backslashreplace").splitlines()
    return done.returncode, (done.stdout or b"").decode("latin-1"), errors


@pytest.mark.parametrize(
    ("ending", "code"),
    [("return 0", 0), ("return 2", 2), ("sys.exit(3)", 3), ("sys.exit()", 0)],
)
def test_a_command_decides_its_exit_code(ending: str, code: int) -> None:
    assert tried("print('said')", ending) == (code, "said\n", [])


def test_a_text_as_exit_code_gives_exit_code_1() -> None:
    assert tried("sys.exit('this is wrong')") == (1, "", ["this is wrong"])


def test_a_program_error_keeps_its_traceback() -> None:
    code, _, errors = tried("raise ValueError('ours')")

    assert code == 1
    assert errors[-1] == "ValueError: ours"


@pytest.mark.parametrize(("number", "name"), [("SIGINT", "Ctrl-C"), ("SIGTERM", "SIGTERM")])
def test_a_signal_is_one_line_and_130(number: str, name: str) -> None:
    ended = f"os.kill(os.getpid(), signal.{number})"

    assert tried("print('known')", ended, "return 0") == (
        130, "known\n", [f"tried: ended by {name}"]
    )  # fmt: skip
    assert tried("return 0", load=f"{ended}; signal.pause()") == (
        130, "", [f"tried: ended by {name} before it began"]
    )  # fmt: skip


def test_a_second_ctrl_c_while_python_ends_leaves_no_traceback() -> None:
    code, _, errors = tried(
        "import atexit",
        "atexit.register(os.kill, os.getpid(), signal.SIGINT)",
        "os.kill(os.getpid(), signal.SIGINT)",
    )

    assert code == -signal.SIGINT
    assert errors == ["tried: ended by Ctrl-C"]


def test_a_disk_error_is_one_line_and_exit_code_3(tmp_path: Path) -> None:
    absent = tmp_path / "absent" / "x"

    assert tried(f"open({str(absent)!r})") == (
        3, "", [f"tried: {absent}: No such file or directory"]
    )  # fmt: skip


def test_a_full_standard_output_ends_a_command_that_only_shows() -> None:
    code, _, errors = tried(
        "print('x' * 100_000)", "print('never', file=sys.stderr)", "return 0", stdout="/dev/full"
    )

    assert (code, errors) == (3, [FULL])


def test_a_short_unwritten_output_counts_as_lost_too() -> None:
    assert tried("print('x')", "return 0", stdout="/dev/full") == (3, "", [FULL])


@pytest.mark.parametrize("code", [0, 1])
def test_a_working_command_goes_on_without_standard_output(code: int) -> None:
    ended, _, errors = tried(
        "with working():",
        "    print('x' * 100_000, flush=True)",
        "    print('went on', file=sys.stderr)",
        f"return {code}",
        stdout="/dev/full",
    )

    assert (ended, errors) == (code or 3, ["went on", FULL])


def test_a_printing_thread_causes_no_traceback() -> None:
    code, _, errors = tried(
        "thread = threading.Thread(target=lambda: print('x', flush=True))",
        "thread.start()",
        "thread.join()",
        stdout="/dev/full",
    )

    assert (code, errors) == (3, [FULL])


def test_a_closed_pipe_ends_a_command_that_only_shows() -> None:
    reader, writer = os.pipe()
    os.close(reader)

    code, _, errors = tried("while True:", "    print('x')", stdout=writer)

    os.close(writer)
    assert code == 3
    assert errors == ["tried: standard output: Broken pipe; the rest of the output is lost"]


def test_no_file_is_opened_in_place_of_a_closed_standard_output(tmp_path: Path) -> None:
    """Such a file would get descriptor 1, and the output of libraries and children would go into
    it."""
    log = tmp_path / "bus.log"
    script = FRAME.format(
        body=f"    log = open({str(log)!r}, 'w')\n    os.system('echo from a child')\n"
        "    with working():\n        print('x')",
        load="    pass",
    )
    done = subprocess.run(
        ["sh", "-c", '"$0" -c "$1" >&- <&-', sys.executable, script],
        capture_output=True,
        text=True,
        timeout=SECONDS,
        check=False,
    )

    assert (done.returncode, done.stderr.splitlines()) == (3, [CLOSED])
    assert log.read_text() == ""


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252:strict"])
def test_characters_that_a_terminal_cannot_show_are_replaced_with_a_notice(encoding: str) -> None:
    code, said, errors = tried("print('II → III, ┃')", PYTHONIOENCODING=encoding, PYTHONUTF8="0")

    assert (code, said) == (3, "II ? III, ?\n")
    assert len(errors) == 1
    assert "cannot show '\\u2192' and 1 other character; set PYTHONIOENCODING=utf-8" in errors[0]


def test_requested_replacements_come_without_a_notice() -> None:
    assert tried("print('→')", PYTHONIOENCODING="ascii:namereplace") == (
        0, "\\N{RIGHTWARDS ARROW}\n", []
    )  # fmt: skip


def test_without_standard_error_the_exit_code_remains() -> None:
    script = FRAME.format(body="    raise OSError(28, 'No space left')", load="    pass")

    done = subprocess.run(
        ["sh", "-c", '"$0" -c "$1" 2>/dev/full', sys.executable, script],
        timeout=SECONDS,
        check=False,
    )

    assert done.returncode == 3
