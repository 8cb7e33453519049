"""The kernel ends a process that hangs, and not one that goes on."""

import signal
import subprocess
import sys

import pytest

from firmware_py.clock.watchdog import ProcessWatchdog

HANGS = """
from firmware_py.clock.watchdog import ProcessWatchdog
ProcessWatchdog(0.3).kick()
while True:
    pass
"""
HANGS_IN_C = """
from firmware_py.clock.watchdog import ProcessWatchdog
ProcessWatchdog(0.3).kick()
sum(range(10**12))
"""
GOES_ON = """
from firmware_py.clock.clock import WallClock
from firmware_py.clock.watchdog import ProcessWatchdog
clock, dog = WallClock(), ProcessWatchdog(5.0)
for _ in range(30):
    dog.kick()
    clock.wait_until(clock.now_ns() + 10_000_000)
dog.stop()
print("lives")
"""


@pytest.mark.parametrize("program", [HANGS, HANGS_IN_C])
def test_a_process_that_hangs_is_ended(program: str) -> None:
    done = subprocess.run([sys.executable, "-c", program], timeout=60, check=False)

    assert done.returncode == -signal.SIGALRM


def test_a_process_that_kicks_the_watchdog_in_time_lives() -> None:
    done = subprocess.run(
        [sys.executable, "-c", GOES_ON], capture_output=True, text=True, timeout=60, check=False
    )

    assert (done.returncode, done.stdout) == (0, "lives\n")


@pytest.mark.parametrize("limit_s", [0.0, -1.0, float("nan")])
def test_an_invalid_limit_is_refused(limit_s: float) -> None:
    with pytest.raises(ValueError, match="limit_s"):
        ProcessWatchdog(limit_s)
