"""Changing ends: the place that goes over holds the true place, or it is unknown."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vobc.atp.change_ends import LENGTH_ERROR_M, OtherPath, hand_over
from vobc.vocabulary import OdometryRecord, PlaceProof

START_M, END_M, LENGTH_M, WIDTH_M = -120.0, 4700.0, 68.59, 30.0
PATH = OtherPath(START_M, END_M, lambda at_m: START_M + END_M - at_m)


def handed(
    record: OdometryRecord, *, standstill: bool = True, emergency: bool = False
) -> OdometryRecord:
    return hand_over(
        record,
        PATH,
        train_length_m=LENGTH_M,
        standstill=standstill,
        emergency=emergency,
        width_m_max=WIDTH_M,
    )


def record(
    front_m: float = 4500.0, bound_m: float = 0.1, proof: PlaceProof = PlaceProof.REMEMBERED
) -> OdometryRecord:
    return OdometryRecord(front_m, bound_m, 0.01, proof)


@given(
    front_m=st.floats(0.0, 4600.0),
    bound_m=st.floats(0.0, 14.0),
    front_share=st.floats(-1.0, 1.0),
    length_share=st.floats(-1.0, 1.0),
)
def test_the_new_interval_holds_the_true_rear(
    front_m: float, bound_m: float, front_share: float, length_share: float
) -> None:
    """The oracle places the true train anywhere in the old interval, with any allowed length."""
    true_front_m = front_m + front_share * bound_m
    true_length_m = LENGTH_M + length_share * LENGTH_ERROR_M
    new_front_m = START_M + END_M - (true_front_m - true_length_m)

    new = handed(record(front_m, bound_m))

    assert new.proof is PlaceProof.REMEMBERED
    assert abs(new_front_m - new.front_m) <= new.bound_m + 1e-9
    assert new.bound_m == bound_m + LENGTH_ERROR_M
    assert new.m_per_pulse == 0.01


@pytest.mark.parametrize(
    ("before", "standstill", "emergency"),
    [
        (record(), False, False),
        (record(), True, True),
        (record(proof=PlaceProof.UNKNOWN), True, False),
        (record(bound_m=WIDTH_M / 2.0 - LENGTH_ERROR_M + 0.001), True, False),
    ],
)
def test_otherwise_the_train_may_be_anywhere(
    before: OdometryRecord, standstill: bool, emergency: bool
) -> None:
    new = handed(before, standstill=standstill, emergency=emergency)

    assert new.proof is PlaceProof.UNKNOWN
    assert new.front_m - new.bound_m == START_M
    assert new.front_m + new.bound_m == END_M


def test_an_interval_of_just_the_greatest_width_goes_over() -> None:
    new = handed(record(bound_m=WIDTH_M / 2.0 - LENGTH_ERROR_M))

    assert new.proof is PlaceProof.REMEMBERED


def test_ends_changed_twice_give_the_place_again_and_a_wider_interval() -> None:
    once = handed(record())
    twice = handed(once)

    assert twice.front_m == pytest.approx(4500.0)
    assert twice.bound_m == pytest.approx(1.1)


@given(front_m=st.floats(0.0, 4600.0), bound_m=st.floats(0.0, 14.0))
def test_a_train_that_leads_on_with_its_cab_keeps_front_and_interval(
    front_m: float, bound_m: float
) -> None:
    new = hand_over(
        record(front_m, bound_m),
        OtherPath(START_M, END_M, lambda at_m: at_m - 1000.0, turns=False),
        train_length_m=LENGTH_M,
        standstill=True,
        emergency=False,
        width_m_max=WIDTH_M,
    )

    assert (new.front_m, new.bound_m) == (front_m - 1000.0, bound_m)
    assert new.proof is PlaceProof.REMEMBERED
