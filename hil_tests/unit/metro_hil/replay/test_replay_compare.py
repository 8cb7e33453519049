"""Comparison of two sequences of outputs."""

from collections.abc import Sequence

from hypothesis import given
from hypothesis import strategies as st

from can_dbc.codec import Encoder
from can_dbc.vobc import AtoPhase, Missing, Supervision, VobcStatus
from metro_hil.replay.compare import Placed, compare
from metro_hil.replay.recording import Output

OUTPUTS = st.lists(
    st.tuples(st.integers(0, 20), st.sampled_from(["101", "103"]), st.binary(max_size=2)),
    max_size=30,
)


def said(outputs: Sequence[tuple[int, str, bytes]]) -> list[Placed]:
    ordered = sorted(outputs, key=lambda each: each[0])
    return [
        Placed(at, order, at, Output("can", key, data))
        for order, (at, key, data) in enumerate(ordered)
    ]


def status(work_us: float, slips: int) -> Output:
    frame = VobcStatus(
        Supervision.NOMINAL, AtoPhase.RUNNING, Missing.NOTHING, True, False, work_us, slips
    )
    ((_, data),) = Encoder([VobcStatus]).encode(frame)
    return Output("can", "181", data)


@given(OUTPUTS)
def test_equal_sequences_are_identical(outputs: list[tuple[int, str, bytes]]) -> None:
    result = compare(said(outputs), said(outputs))

    assert result.identical
    assert sum(counts.same for counts in result.counts.values()) == len(outputs)


@given(OUTPUTS, OUTPUTS, st.integers(0, 5))
def test_every_output_of_both_is_counted_once(
    one: list[tuple[int, str, bytes]], other: list[tuple[int, str, bytes]], tolerance_ns: int
) -> None:
    counts = compare(said(one), said(other), tolerance_ns=tolerance_ns).counts.values()

    pairs = sum(each.same + each.masked + each.changed for each in counts)
    assert pairs + sum(each.missing for each in counts) == len(one)
    assert pairs + sum(each.extra for each in counts) == len(other)


def test_a_missing_output_does_not_shift_the_later_ones() -> None:
    whole = [(at, "101", bytes([at])) for at in range(0, 100, 10)]

    result = compare(said(whole), said([each for each in whole if each[0] != 40]))

    assert result.counts["can", "101"].missing == 1
    assert result.counts["can", "101"].same == 9
    assert result.first is not None
    assert result.first.recorded is not None
    assert result.first.recorded.at_ns == 40


def test_within_the_tolerance_equal_outputs_are_paired() -> None:
    one = [(10, "101", b"a"), (20, "101", b"b")]
    other = [(12, "101", b"x"), (13, "101", b"a"), (22, "101", b"b")]

    counts = compare(said(one), said(other), tolerance_ns=5).counts["can", "101"]

    assert (counts.same, counts.extra, counts.changed, counts.missing) == (2, 1, 0, 0)


def test_the_first_difference_is_the_earliest_of_all_identifiers() -> None:
    one = [(10, "101", b"a"), (20, "103", b"b"), (30, "101", b"c")]
    other = [(10, "101", b"a"), (20, "103", b"X"), (30, "101", b"Y")]

    first = compare(said(one), said(other)).first

    assert first is not None
    assert first.recorded is not None
    assert first.recorded.output.key == "103"


def test_only_fields_that_depend_on_the_host_are_masked() -> None:
    recorded = [Placed(0, 0, 0, status(600.0, 0)), Placed(1, 1, 1, status(600.0, 0))]
    replayed = [Placed(0, 0, 0, status(0.0, 0)), Placed(1, 1, 1, status(0.0, 1))]

    masked = compare(recorded, replayed, mask=True).counts["can", "181"]
    exact = compare(recorded, replayed).counts["can", "181"]

    assert (masked.masked, masked.changed) == (1, 1)
    assert exact.changed == 2
