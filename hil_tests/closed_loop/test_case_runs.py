"""Whole cases in virtual time: identical frames each time, alone, in a group, and with faults."""

import functools
from collections.abc import Sequence

import msgspec
import pytest

from firmware_py.settings import SettingsError
from metro_hil.campaign.builder import Scenario
from metro_hil.model.case import Case, CaseResult, Host, Verdict
from metro_hil.pytest.bench import Bench, BenchTimeoutError
from metro_hil.pytest.plugin import bench
from metro_hil.run.branch import group_key
from metro_hil.run.dispatch import run_case, run_group
from vobc.process import VobcDevice
from vobc.vocabulary import CycleOutput

__all__ = ["bench"]

HOP = {"start": "II", "end": "III", "duration_s": 180.0}
SHORT = {**HOP, "duration_s": 15.0}
"""Takes the train out of its station."""
ARRIVES = {"name": "arrives", "measure": "arrived_count", "min": 1.0}


def hop(train: dict[str, object] = HOP, **keys: object) -> Scenario:
    return Scenario(name="hop", train=train, **keys)  # type: ignore[arg-type]


def without_host(results: Sequence[CaseResult]) -> list[CaseResult]:
    """The results without the data that differ from run to run."""
    return [msgspec.structs.replace(result, host=Host()) for result in results]


@functools.cache
def plain() -> CaseResult:
    """The result of the hop without a fault, computed once for all comparisons."""
    return run_case(hop(monitor=[ARRIVES]).cases()[0])


def test_the_same_case_gives_exactly_the_same_result() -> None:
    (case,) = hop(monitor=[ARRIVES]).cases()

    one, two = plain(), run_case(case)

    assert one.verdict is Verdict.PASS, one.reason
    assert without_host([one]) == without_host([two])
    assert len(one.chain) == 64


def test_another_seed_gives_other_frames() -> None:
    one, other = hop(SHORT, seeds=2).cases()

    assert run_case(other).chain != run_case(one).chain


def test_logs_change_nothing(bench: Bench) -> None:
    kept = bench.run(hop(monitor=[ARRIVES]))

    assert without_host([kept]) == without_host([plain()])


@pytest.mark.parametrize(
    "faults",
    [
        [],
        [
            {"kind": "frame_drop", "loss_ratio": 0.02},
            {"kind": "telegram_torn", "share_ratio": 0.2},
            {"kind": "radio_delay", "delay_s": 0.1, "jitter_s": 0.1},
            {"kind": "slow_cycle", "extra_s": 0.001, "when": "front_m > 3180"},
            {"kind": "brake_weak", "gain_ratio": 0.9},
        ],
        [
            {"kind": "masquerade", "frame": "BRAKE_CMD", "when": "front_m > 3150"},
            {"kind": "babbling_idiot", "can_id": 2047, "when": "front_m > 3140", "duration_s": 1.0},
            {"kind": "bus_off", "node": "odo", "when": "front_m > 3165", "duration_s": 1.0},
            {"kind": "desk_mode", "mode": "off", "when": "front_m > 3180"},
            {"kind": "door_lock_lost", "when": "front_m > 3175", "duration_s": 1.0},
            {"kind": "line_voltage", "when": "front_m > 3130", "duration_s": 2.0},
            {"kind": "wheel_slip", "when": "front_m > 3125", "duration_s": 1.0},
        ],
    ],
)
def test_cases_continued_from_one_branch_equal_those_run_alone(
    faults: list[dict[str, object]],
) -> None:
    branch = {"seed": 9, "when": "front_m > 3120"}
    short = {**HOP, "duration_s": 32.0}
    cases = Scenario(name="hop", train=short, seeds=3, branch=branch, fault=faults).cases()

    grouped = list(run_group(cases))

    assert without_host(grouped) == without_host([run_case(case) for case in cases])
    assert len({result.chain for result in grouped}) == len(cases)


def test_cases_with_different_faults_are_grouped_only_if_the_results_stay_equal() -> None:
    """Faults of bus and process change the reception of the monitors, even before the branch."""
    branch = {"seed": 9, "when": "front_m > 3120"}
    faults: list[list[dict[str, object]]] = [
        [],
        [{"kind": "passenger_alarm"}],
        [{"kind": "frame_delay", "delay_s": 0.05}],
        [{"kind": "controller_paused", "duration_s": 0.2}],
        [{"kind": "clock_step", "step_s": 0.1}],
    ]
    short = {**HOP, "duration_s": 30.0}
    cases = [
        msgspec.structs.replace(case, id=f"{number}/{case.id}")
        for number, fault in enumerate(faults)
        for case in Scenario(name="hop", train=short, branch=branch, fault=fault).cases()
    ]
    groups: dict[bytes | None, list[Case]] = {}
    for case in cases:
        groups.setdefault(group_key(case), []).append(case)

    grouped = [result for group in groups.values() for result in run_group(group)]

    assert [len(group) for group in groups.values()] == [2, 2, 1]
    assert without_host(grouped) == without_host([run_case(case) for case in cases])


def test_a_branch_that_never_comes_blocks_the_case() -> None:
    (case,) = hop(SHORT, branch={"seed": 9, "when": "front_m > 9000"}).cases()

    result = run_case(case)

    assert result.verdict is Verdict.BLOCKED
    assert "the branch" in result.reason


def test_a_fault_that_never_begins_blocks_the_case() -> None:
    (case,) = hop(SHORT, fault=[{"kind": "brake_weak", "when": "speed_mps > 90"}]).cases()

    result = run_case(case)

    assert result.verdict is Verdict.BLOCKED
    assert "brake_weak" in result.reason


def test_a_fault_after_the_end_of_the_run_changes_no_frame() -> None:
    (faulty,) = hop(fault=late_faults()).cases()

    assert run_case(faulty).chain == plain().chain


def test_future_faults_do_not_change_the_schedule_of_an_odd_cycle() -> None:
    odd = {**HOP, "duration_s": 20.0, "cycle_ms": 31.25}
    (plain,) = Scenario(name="hop", train=odd).cases()
    (faulty,) = Scenario(name="hop", train=odd, fault=late_faults()).cases()

    assert run_case(plain).chain == run_case(faulty).chain


def late_faults() -> list[dict[str, object]]:
    """One fault for each place where faults act."""
    kinds = ("frame_drop", "wheel_slip", "telegram_torn", "brake_weak", "line_voltage")
    more = ("door_lock_lost", "passenger_alarm", "radio_loss", "controller_paused")
    return [{"kind": kind, "start_s": 1000.0} for kind in (*kinds, *more)]


@pytest.mark.sources
def test_a_crashed_controller_fails_the_case_and_the_run_continues_to_standstill(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    decide = VobcDevice._decide

    def dies_at_20_s(self: VobcDevice, now_ns: int, overruns: int) -> CycleOutput:
        if now_ns >= 20_000_000_000:
            raise ZeroDivisionError("a mistake of ours")
        return decide(self, now_ns, overruns)

    monkeypatch.setattr(VobcDevice, "_decide", dies_at_20_s)
    (case,) = hop().cases()

    result = run_case(case)

    assert result.verdict is Verdict.FAIL
    assert "ZeroDivisionError: a mistake of ours" in result.reason
    assert result.exit_reason == "the controller died"
    end_m, top_mps = result.measures["front_end_m"], result.measures["speed_max_mps"]
    assert end_m is not None
    assert top_mps is not None
    # The train had left its station and stands well before the next one.
    assert 3001.0 < end_m < 3400.0
    assert result.sim_s < 60.0


@pytest.mark.sources
def test_a_bench_error_is_no_verdict_on_the_controller(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(self: object, stamp_ns: int, can_id: int, data: bytes) -> None:
        raise KeyError("the bench")

    monkeypatch.setattr("metro_hil.model.frame_hash.FrameHash.frame", fails)
    (case,) = hop().cases()

    with pytest.raises(KeyError):
        run_case(case)


@pytest.mark.sources
def test_a_bench_error_inside_a_controller_call_is_no_verdict_either(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(self: object, stamp_ns: int, can_id: int, data: bytes) -> None:
        raise KeyError("the monitors")

    monkeypatch.setattr("metro_hil.monitors.MonitorSet.said", fails)
    (case,) = hop(fault=[{"kind": "frame_drop", "start_s": 1000.0}]).cases()

    with pytest.raises(KeyError):
        run_case(case)


def test_an_inconsistent_case_is_blocked_with_a_reason() -> None:
    (case,) = hop().cases()
    setup = msgspec.structs.replace(case.setup, consist="no_such_train")

    result = run_case(msgspec.structs.replace(case, setup=setup))

    assert result.verdict is Verdict.BLOCKED
    assert "no_such_train" in result.reason


def test_a_run_ends_early_when_the_train_stands_to_the_end() -> None:
    (case,) = hop(fault=[{"kind": "emergency_button", "when": "front_m > 3100"}]).cases()

    result = run_case(case)

    assert result.exit_reason == "stands for good"
    assert result.sim_s < 140.0


def test_a_test_can_observe_and_disturb_a_running_train(bench: Bench) -> None:
    run = bench.start(hop())
    run.run_until("speed_mps > 8", timeout_s=60.0)
    before_m = run.train.front_m
    run.plan_faults({"kind": "emergency_button"})

    run.run_until("speed_mps == 0", timeout_s=30.0)

    assert run.controller.supervision.name == "EMERGENCY"
    assert run.train.front_m - before_m < 60.0
    assert run.close().measures["emergency_count"] == 1.0


def test_a_wait_that_times_out_raises_an_error_that_names_its_condition(bench: Bench) -> None:
    run = bench.start(hop())

    with pytest.raises(BenchTimeoutError, match=r"speed_mps > 90: not within 5 s"):
        run.run_until("speed_mps > 90", timeout_s=5.0)


def test_a_run_that_a_test_drives_equals_one_that_runs_by_itself(bench: Bench) -> None:
    run = bench.start(hop())
    run.run_for(12.3)
    run.run_until(lambda: run.arrived, timeout_s=120.0)

    result = run.close()

    assert result.chain == plain().chain


def test_cases_travel_as_json_unchanged() -> None:
    (case,) = hop(monitor=[ARRIVES], fault=late_faults()).cases()

    assert msgspec.json.decode(msgspec.json.encode(case), type=Case) == case


def test_unknown_faults_are_refused_during_a_run(bench: Bench) -> None:
    run = bench.start(hop())

    with pytest.raises(SettingsError, match="NOPE"):
        run.plan_faults({"kind": "frame_drop", "frames": "NOPE*"})


def test_an_active_fault_cannot_be_removed(bench: Bench) -> None:
    run = bench.start(hop())
    run.plan_faults({"kind": "brake_weak"})
    run.run_for(1.0)

    with pytest.raises(SettingsError, match="brake_weak still acts"):
        run.plan_faults({"kind": "brake_late"})


@pytest.mark.parametrize("memory_lost", [False, True])
def test_the_centre_accepts_a_restarted_controller_with_or_without_its_memory(
    memory_lost: bool,
) -> None:
    """The controller restarts at 6 s. Bit 512 of its departure inhibits means that the centre is
    silent."""
    killed = {
        "kind": "controller_killed",
        "start_s": 5.0,
        "end_s": 6.0,
        "memory_lost": memory_lost,
    }
    heard = {"name": "heard", "stl": "always(t_s > 8 -> departure_inhibits < 512)"}
    train = {"start": "II", "end": "III", "duration_s": 20.0}
    (case,) = Scenario(name="lost", train=train, fault=[killed], monitor=[heard]).cases()

    result = run_case(case)

    assert {each.name: each.verdict for each in result.monitors}["heard"] is Verdict.PASS
