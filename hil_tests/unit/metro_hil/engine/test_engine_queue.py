"""The queue: in which order, in which groups and how often cases are handed out."""

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from metro_hil.engine.queue import ATTEMPTS_MAX, WorkQueue, chunks
from metro_hil.engine.trial_runner import trial_cases
from metro_hil.model.case import BenchKind, Branch, Case, Verdict


def drained(queue: WorkQueue) -> list[tuple[str, ...]]:
    return [tuple(case.id for case in queue.take().cases) for _ in range(len(queue))]


def by_scenario(case: Case) -> bytes | None:
    return None if case.branch is None else case.scenario.encode()


def branched(cases: tuple[Case, ...]) -> tuple[Case, ...]:
    branch = Branch(seed=1, when="speed_mps > 1.0")
    return tuple(msgspec.structs.replace(case, branch=branch) for case in cases)


def test_cases_are_handed_out_one_by_one_in_their_order() -> None:
    cases = trial_cases(4)

    queue = WorkQueue(reversed(cases), workers=2)

    assert drained(queue) == [(case.id,) for case in cases]


def test_real_time_comes_last_and_alone() -> None:
    cases = list(trial_cases(3))
    cases[0] = msgspec.structs.replace(cases[0], bench=BenchKind.PROCESSES)
    queue = WorkQueue(cases, workers=2)

    batches = [queue.take() for _ in range(len(queue))]

    assert [batch.cases[0].index for batch in batches] == [1, 2, 0]
    assert [batch.alone for batch in batches] == [False, False, True]


def test_cases_of_a_branch_go_together_in_pieces_for_all_workers() -> None:
    cases = (*branched(trial_cases(8, "a")), *trial_cases(1, "b"))

    pieces = list(chunks(cases, 2, by_scenario))

    assert sorted(len(piece) for piece in pieces) == [1, 2, 2, 2, 2]


@given(st.lists(st.sampled_from("abc"), max_size=40), st.integers(1, 8))
def test_no_case_is_left_out_or_doubled(scenarios: list[str], workers: int) -> None:
    cases = [
        msgspec.structs.replace(case, scenario=name)
        for case, name in zip(branched(trial_cases(len(scenarios))), scenarios, strict=True)
    ]

    found = [case for piece in chunks(cases, workers, by_scenario) for case in piece]

    assert sorted(case.index for case in found) == list(range(len(cases)))
    for piece in chunks(cases, workers, by_scenario):
        assert len({case.scenario for case in piece}) == 1


def test_a_case_whose_worker_dies_is_tried_three_times_and_then_lost() -> None:
    queue = WorkQueue(trial_cases(1), workers=1)
    reasons = []

    while len(queue):
        batch = queue.take()
        reasons += queue.failed(batch, batch.cases, 1, f"death {batch.attempt}")

    (result,) = reasons
    assert (result.verdict, result.reason) == (Verdict.LOST, f"death {ATTEMPTS_MAX}")
    assert result.host.attempts == ATTEMPTS_MAX


def test_only_the_running_case_is_suspected() -> None:
    """The worker died at the second case of four: the other cases go on first and without blame."""
    cases = branched(trial_cases(4))
    queue = WorkQueue(cases, workers=1, key=lambda case: b"x")
    (first, second) = (queue.take(), queue.take())

    lost = queue.failed(first, first.cases[1:], 1, "death")

    assert lost == []
    assert [len(piece) for piece in (first.cases, second.cases)] == [2, 2]
    suspect = queue.take()
    assert (suspect.cases, suspect.attempt) == (first.cases[1:], 2)


def test_cases_waiting_at_a_dead_worker_are_next_and_without_blame() -> None:
    queue = WorkQueue(trial_cases(3), workers=1)
    batch = queue.take()

    queue.failed(batch, batch.cases, 0, "death")

    assert queue.take().cases == batch.cases
    assert len(queue) == 2
