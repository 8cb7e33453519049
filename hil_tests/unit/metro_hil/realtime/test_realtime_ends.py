"""When a real-time case is over, and when its controller counts as dead."""

import pytest

from metro_hil.model.end_condition import ARRIVED
from metro_hil.realtime.ends import (
    DIED,
    DURATION,
    KILLED,
    RESTART_NS,
    SILENT_NS,
    STUCK,
    VIOLATION,
    Pulse,
    TrueMotion,
    over,
)
from metro_hil.realtime.fault_watch import FaultWatch
from plant_emulator.faults.plan import read_faults
from plant_emulator.truth import Truth

S = 1_000_000_000
STOP_M = 3500.0


def truth(t_s: float, front_m: float, speed_mps: float = 0.0, *, doors_open: bool = False) -> Truth:
    sample = Truth()
    sample.t_s, sample.front_m, sample.speed_mps = t_s, front_m, speed_mps
    sample.right_open = float(doors_open)
    return sample


def moving() -> TrueMotion:
    motion = TrueMotion(stop_m=STOP_M, patience_s=90.0)
    motion.take(truth(0.0, 3000.0, 0.0))
    motion.take(truth(10.0, 3050.0, 12.0))
    return motion


def ask(motion: TrueMotion, pulse: Pulse | None = None, now_s: float = 10.0, **told: bool) -> str:
    flags = {"violated": False, "killed_for_good": False, "pending": False, **told}
    return over(motion, pulse or Pulse(), round(now_s * S), began_ns=0, duration_s=100.0, **flags)


def dead(at_s: float) -> Pulse:
    pulse = Pulse()
    pulse.check(round(at_s * S), ended="exit code 1", last_ns=0, restarted_ns=None, excused=False)
    return pulse


def test_a_train_on_its_way_goes_on() -> None:
    assert ask(moving()) == ""


def test_a_train_has_arrived_after_standing_with_open_doors_at_its_last_station() -> None:
    motion = moving()
    motion.take(truth(50.0, STOP_M - 0.03, doors_open=True))
    assert ask(motion) == ""

    motion.take(truth(53.0, STOP_M - 0.03, doors_open=True))

    assert ask(motion) == ARRIVED


def test_open_doors_elsewhere_are_no_arrival() -> None:
    motion = moving()
    for t_s in (50.0, 60.0):
        motion.take(truth(t_s, 3200.0, doors_open=True))

    assert ask(motion) == ""


def test_after_a_controllers_death_the_run_continues_to_standstill() -> None:
    motion = moving()
    assert ask(motion, dead(10.0), now_s=12.0) == ""

    for t_s in (20.0, 22.0):
        motion.take(truth(t_s, 3120.0))

    assert ask(motion, dead(10.0), now_s=22.0) == DIED


def test_after_a_controllers_death_the_run_has_a_time_limit() -> None:
    assert ask(moving(), dead(10.0), now_s=10.0 + 181.0) == DIED


def test_without_truth_the_controller_reports_the_arrival() -> None:
    motion = TrueMotion(stop_m=STOP_M, patience_s=90.0)
    motion.believe(0.0, 3000.0, doors_open=False)
    for t_s in (50.0, 53.0):
        motion.believe(t_s, STOP_M + 0.02, doors_open=True)

    assert ask(motion) == ARRIVED
    assert motion.moved_m == pytest.approx(500.02)
    assert not motion.stood(0.0), "standstill must not be claimed"


def test_without_truth_a_run_ends_soon_after_its_controllers_death() -> None:
    assert ask(moving(), dead(10.0), now_s=21.0, truth_known=False) == DIED
    assert ask(moving(), dead(10.0), now_s=21.0, truth_known=True) == ""


def test_a_violation_ends_the_case_at_once() -> None:
    assert ask(moving(), violated=True) == VIOLATION


def test_a_case_ends_after_its_duration() -> None:
    assert ask(moving(), now_s=100.0) == DURATION


def test_a_case_with_a_permanently_killed_controller_ends_at_standstill() -> None:
    motion = moving()
    assert ask(motion, killed_for_good=True) == ""

    for t_s in (20.0, 22.0):
        motion.take(truth(t_s, 3120.0))

    assert ask(motion, killed_for_good=True) == KILLED


@pytest.mark.parametrize(("pending", "reason"), [(False, STUCK), (True, "")])
def test_a_train_that_stands_for_long_is_stuck_unless_a_fault_will_still_change(
    pending: bool, reason: str
) -> None:
    motion = moving()
    for t_s in (20.0, 111.0):
        motion.take(truth(t_s, 3120.0))

    assert ask(motion, now_s=50.0, pending=pending) == reason


def check(pulse: Pulse, now_ns: int, **told: object) -> bool:
    given = {"ended": "", "last_ns": 0, "restarted_ns": None, "excused": False, **told}
    return pulse.check(now_ns, **given)  # type: ignore[arg-type]


def test_a_controller_that_is_silent_for_too_long_is_reported_dead_once() -> None:
    pulse = Pulse()

    assert not check(pulse, SILENT_NS)
    assert check(pulse, SILENT_NS + 1)
    assert "silent for 2.0 s" in pulse.died
    assert not check(pulse, SILENT_NS + 2)


def test_a_process_that_ended_by_itself_is_dead_at_once() -> None:
    pulse = Pulse()

    assert check(pulse, 5, ended="by SIGSEGV")
    assert pulse.died == "by SIGSEGV"


def test_silence_during_a_process_fault_does_not_count() -> None:
    assert not check(Pulse(), 10 * S, excused=True)


def test_a_restarted_controller_has_limited_time_to_send() -> None:
    pulse = Pulse()

    assert not check(pulse, 5 * S + RESTART_NS, restarted_ns=5 * S)
    assert check(pulse, 5 * S + RESTART_NS + 1, restarted_ns=5 * S)


def test_the_case_waits_for_timed_faults_but_not_for_conditions() -> None:
    plans = read_faults(
        [
            {"kind": "tacho_stuck", "start_s": 5.0, "duration_s": 2.0},
            {"kind": "doppler_outage", "when": "speed_mps > 90"},
        ],
        "case",
    )
    watch = FaultWatch(plans)
    assert watch.pending

    watch.change(plans[0], active=True)
    assert watch.pending, "its end is still to come"
    watch.change(plans[0], active=False)

    assert not watch.pending
    stuck, outage = watch.results({0: 40})
    assert (stuck.began, stuck.touched) == (True, 40)
    assert (outage.began, outage.touched) == (False, None), "no device counted it"
