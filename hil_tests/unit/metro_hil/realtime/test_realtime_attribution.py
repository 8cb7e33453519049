"""Attribution of a failure in real time to controller or host: the rules, with invented
evidence."""

import pytest

from metro_hil.model.case import Verdict
from metro_hil.realtime.attribution import (
    BLIND_S,
    HANG_S,
    LATE_S,
    LOOKBACK_S,
    NO_EXCUSE_S,
    STEAL_S,
    CycleRow,
    Disturbance,
    DisturbanceSource,
    Failure,
    HostEvidence,
    RunWindow,
    lateness_disturbances,
    plant_disturbances,
    rule,
    second_disturbances,
)

CYCLE_S = 0.05


def stolen(begin_s: float, end_s: float, amount_s: float = 0.3) -> Disturbance:
    return Disturbance(begin_s, end_s, DisturbanceSource.STEAL, amount_s)


def test_a_failure_on_a_quiet_host_is_the_controllers() -> None:
    ruling = rule(Verdict.FAIL, [Failure(40.0)], HostEvidence())

    assert ruling.verdict is Verdict.FAIL


def test_a_failure_just_after_stolen_processor_time_is_invalid_with_the_reason() -> None:
    ruling = rule(Verdict.FAIL, [Failure(40.0)], HostEvidence(disturbances=[stolen(38.0, 39.0)]))

    assert ruling.verdict is Verdict.INVALID
    for words in ("stolen", "300 ms", "38.00..39.00"):
        assert words in ruling.reason


@pytest.mark.parametrize(
    ("begin_s", "end_s"),
    [(40.5, 41.5), (10.0, 11.0), (40.0 - LOOKBACK_S - 1.1, 40.0 - LOOKBACK_S - 0.1)],
)
def test_disturbances_after_a_failure_or_long_before_excuse_nothing(
    begin_s: float, end_s: float
) -> None:
    ruling = rule(
        Verdict.FAIL, [Failure(40.0)], HostEvidence(disturbances=[stolen(begin_s, end_s)])
    )

    assert ruling.verdict is Verdict.FAIL


def test_one_unexcused_failure_fails_the_run() -> None:
    ruling = rule(
        Verdict.FAIL,
        [Failure(40.0), Failure(80.0)],
        HostEvidence(disturbances=[stolen(38.0, 39.0)]),
    )

    assert ruling.verdict is Verdict.FAIL


def test_a_failure_of_the_whole_run_is_excused_by_any_disturbance() -> None:
    ruling = rule(Verdict.FAIL, [Failure(None)], HostEvidence(disturbances=[stolen(3.0, 4.0)]))

    assert ruling.verdict is Verdict.INVALID


def test_a_program_that_ends_by_itself_has_no_excuse() -> None:
    evidence = HostEvidence(disturbances=[stolen(38.0, 39.0, 5.0)])

    assert rule(Verdict.FAIL, [Failure(40.0, NO_EXCUSE_S)], evidence).verdict is Verdict.FAIL


@pytest.mark.parametrize(
    ("amount_s", "verdict"), [(0.9 * HANG_S, Verdict.FAIL), (HANG_S, Verdict.INVALID)]
)
def test_silence_is_excused_only_by_a_disturbance_that_can_cause_it(
    amount_s: float, verdict: Verdict
) -> None:
    evidence = HostEvidence(disturbances=[stolen(38.0, 39.0, amount_s)])

    assert rule(Verdict.FAIL, [Failure(40.0, HANG_S)], evidence).verdict is verdict


def test_disturbances_at_the_start_of_processes_excuse_early_failures_only() -> None:
    evidence = HostEvidence(disturbances=[stolen(0.2, 0.9)])

    assert rule(Verdict.FAIL, [Failure(1.0)], evidence).verdict is Verdict.INVALID
    assert rule(Verdict.FAIL, [Failure(None)], evidence).verdict is Verdict.FAIL


def test_a_pass_on_a_busy_host_stays_a_pass() -> None:
    ruling = rule(Verdict.PASS, [], HostEvidence(disturbances=[stolen(3.0, 4.0)]))

    assert ruling.verdict is Verdict.PASS


@pytest.mark.parametrize(
    ("evidence", "verdict", "words"),
    [
        (HostEvidence(dropped_frames=1), Verdict.INCONCLUSIVE, "1 frames"),
        (HostEvidence(blind=[RunWindow(7.0, 7.2)]), Verdict.INCONCLUSIVE, "0.20 s"),
        (HostEvidence(given_up_s=0.4), Verdict.INVALID, "0.40 s"),
    ],
)
def test_a_pass_without_truth_or_cycles_does_not_count(
    evidence: HostEvidence, verdict: Verdict, words: str
) -> None:
    ruling = rule(Verdict.PASS, [], evidence)

    assert ruling.verdict is verdict
    assert words in ruling.reason


def test_a_pass_survives_a_gap_in_the_truth_that_is_too_short_to_hide_anything() -> None:
    ruling = rule(Verdict.PASS, [], HostEvidence(blind=[RunWindow(7.0, 7.0 + 0.9 * BLIND_S)]))

    assert ruling.verdict is Verdict.PASS


@pytest.mark.parametrize("verdict", [Verdict.BLOCKED, Verdict.INCONCLUSIVE])
def test_a_vacuous_result_stays_vacuous(verdict: Verdict) -> None:
    evidence = HostEvidence(disturbances=[stolen(3.0, 4.0)], dropped_frames=3, given_up_s=1.0)

    assert rule(verdict, [], evidence).verdict is verdict


def test_a_cycle_that_the_host_delayed_is_a_disturbance_from_its_due_instant() -> None:
    rows = [CycleRow(10.0, 0.002, 0.0, CYCLE_S), CycleRow(10.25, 0.002, 0.2, CYCLE_S)]

    (found,) = lateness_disturbances(rows)

    assert found.begin_s == pytest.approx(10.05)
    assert found.amount_s == pytest.approx(0.2)


def test_a_cycle_delayed_by_the_one_before_is_the_controllers_own_fault() -> None:
    """The cycle worked 0.25 s in a period of 0.05 s, so the next one began 0.2 s late by itself."""
    rows = [CycleRow(10.25, 0.25, 0.2, CYCLE_S)]

    assert lateness_disturbances(rows) == []


def test_a_process_fault_of_the_scenario_is_no_disturbance() -> None:
    rows = [CycleRow(12.0, 0.002, 1.0, CYCLE_S)]

    assert lateness_disturbances(rows, [RunWindow(10.9, 12.1)]) == []
    assert len(lateness_disturbances(rows, [RunWindow(20.0, 21.0)])) == 1


def test_everyday_jitter_is_no_disturbance() -> None:
    rows = [CycleRow(10.0, 0.002, 0.9 * LATE_S, CYCLE_S)]

    assert lateness_disturbances(rows) == []
    assert plant_disturbances([(10.0, 0.01)]) == []
    assert second_disturbances([(1.0, 0.9 * STEAL_S)], DisturbanceSource.STEAL, STEAL_S) == []


def test_stolen_time_spans_from_the_sample_before() -> None:
    (found,) = second_disturbances([(1.0, 0.0), (2.1, 0.2)], DisturbanceSource.STEAL, STEAL_S)

    assert (found.begin_s, found.end_s) == (1.0, 2.1)
