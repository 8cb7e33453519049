"""`vcan` as its user meets it, with the embedded bus, which every machine has."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

Vcan = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def vcan() -> Iterator[Vcan]:
    """The console script with a runtime folder of its own."""
    script = str(Path(sys.executable).with_name("vcan"))
    # The address of a socket holds a hundred bytes, too few for the path of a test's folder.
    place = tempfile.TemporaryDirectory()
    environment = {**os.environ, "XDG_RUNTIME_DIR": place.name}

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [script, *arguments],
            env=environment,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )

    with place:
        yield run
        run("down", "--kind", "embedded", "tvcan7")


def test_an_embedded_bus_is_created_listed_and_removed(vcan: Vcan) -> None:
    up = [vcan("up", "--kind", "embedded", "tvcan7") for _ in range(2)]
    shown = vcan("status", "--json", "tvcan7")
    down = [vcan("down", "tvcan7") for _ in range(2)]
    after = vcan("status", "tvcan7")

    assert [done.returncode for done in (*up, shown, *down, after)] == [0, 0, 0, 0, 0, 3]
    assert "already up" in up[1].stdout
    (row,) = json.loads(shown.stdout)
    assert (row["bus"], row["up"], row["frames"]) == ("embedded:tvcan7", True, 0)
    assert "nothing to do" in down[1].stdout


def test_the_loopback_does_not_count_as_a_bus(vcan: Vcan) -> None:
    done = vcan("up", "lo")

    assert done.returncode == 3
    assert "lo exists" in done.stderr


def test_no_user_error_ends_in_a_traceback(vcan: Vcan) -> None:
    for arguments in ([], ["up", "x" * 16], ["up", "a/b"], ["status", ""], ["down", "--kind", "x"]):
        done = vcan(*arguments)

        assert done.returncode == 2, arguments
        assert "Traceback" not in done.stderr
        assert done.stderr


def test_without_asserts_it_does_not_run() -> None:
    script = str(Path(sys.executable).with_name("vcan"))

    done = subprocess.run(
        [sys.executable, "-O", script, "status"], capture_output=True, text=True, check=False
    )

    assert done.returncode == 2
    assert "python -O" in done.stderr
