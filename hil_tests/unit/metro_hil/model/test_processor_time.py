"""The reported processor time is processor time and not wall-clock time."""

import subprocess
import sys
import time

from metro_hil.cli.hil.working import speed_text
from metro_hil.model.case import CaseResult, Host, Verdict
from metro_hil.model.processor_time import processor_time_s

BURNT_S = 0.1
BURN = f"import time\nwhile time.process_time() < {BURNT_S}: pass"
WAIT = "import sys; sys.stdin.read()"


def result(sim_s: float, *, processor_s: float, wall_s: float = 1e6) -> CaseResult:
    host = Host(wall_s=wall_s, processor_s=processor_s)
    return CaseResult(case_id="a", index=0, verdict=Verdict.PASS, sim_s=sim_s, host=host)


def test_the_computation_of_this_process_counts() -> None:
    before_s, own_s = processor_time_s(), time.process_time()
    while time.process_time() < own_s + BURNT_S:
        pass

    assert processor_time_s() - before_s >= 0.9 * BURNT_S


def test_the_computation_of_a_child_counts_once_it_has_ended() -> None:
    before_s = processor_time_s()
    subprocess.run([sys.executable, "-S", "-E", "-c", BURN], check=True)

    assert processor_time_s() - before_s >= 0.9 * BURNT_S


def test_the_computation_of_a_running_child_does_not_count() -> None:
    """The child reports that it has computed; its parent has not waited for it yet."""
    words = [sys.executable, "-S", "-E", "-c", f"{BURN}\nprint(flush=True)\n{WAIT}"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        child.stdout.readline()
        while_s = processor_time_s()
        child.communicate()

    assert processor_time_s() - while_s >= 0.9 * BURNT_S


def test_the_last_line_divides_by_processor_time_and_not_by_wall_time() -> None:
    text = speed_text([result(300.0, processor_s=1.5), result(100.0, processor_s=0.5)])

    assert text == "400 s simulated in 2.0 s of processors: 200 times"


def test_cases_with_unknown_processor_time_do_not_count() -> None:
    known, unknown = result(300.0, processor_s=1.5), result(100.0, processor_s=0.0)

    assert speed_text([known, unknown]) == "300 s simulated in 1.5 s of processors: 200 times"
    assert speed_text([unknown]) == ""
