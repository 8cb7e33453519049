"""The bench's own cyclictest: it makes the configured releases and reports what the host
granted."""

import json
import subprocess
import sys

import pytest

from firmware_py.clock.executive import TaskReport
from firmware_py.clock.realtime import Measure, RealtimeReport
from metro_tools.cyclic_lateness import as_text, main

TIMEOUT_S = 60
REPORT = TaskReport("empty", 50.0, 198, 2, 0, 26.0, 87.0, 134.0, 1.0, 3.0, 9.0)
HOST = RealtimeReport((Measure("SCHED_FIFO", granted=False, detail="Operation not permitted"),))


def test_every_release_is_made_or_counted_as_a_slip() -> None:
    """The tool runs in its own process because it changes the scheduling of that process."""
    done = subprocess.run(
        [
            *(sys.executable, "-m", "metro_tools.cyclic_lateness", "--json"),
            *("--seconds", "0.1", "--period-ms", "5", "--spin-us", "50"),
        ],
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=True,
    )

    told = json.loads(done.stdout)
    # If the host takes the processor away near the end, the last releases are still pending.
    assert 1 <= told["releases"] + told["slips"] <= 20
    assert 0 <= told["lateness_us_p50"] <= told["lateness_us_p99"] <= told["lateness_us_max"]
    assert "garbage collector" in told["granted"]
    assert told["steal_ms"] is None or told["steal_ms"] >= 0


def test_the_text_names_refused_privileges_and_measured_values() -> None:
    assert as_text(REPORT, HOST, 30_000_000).splitlines() == [
        "SCHED_FIFO: not granted, Operation not permitted",
        "releases 198, slips 2, stolen by the host 30 ms",
        "lateness µs: p50 26  p99 87  max 134",
    ]
    assert "stolen by the host unknown" in as_text(REPORT, HOST, None)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--period-ms", "0"], "0 is not positive"),
        (["--seconds", "nan"], "nan is not a length of time"),
        (["--seconds", "soon"], "soon is not a number"),
        (["--spin-us", "-1"], "-1 is not a length of time"),
    ],
)
def test_an_impossible_time_is_refused(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)

    assert caught.value.code == 2
    assert said in capsys.readouterr().err
