"""The departure interlock: the names of the missing terms, and the terms that a jog may ignore."""

import pytest

from can_dbc.vobc import Inhibit
from vobc.atp.departure import NOT_AGAINST_JOG, DepartureTerms, inhibits

ALL = DepartureTerms(*(True,) * len(DepartureTerms._fields))


@pytest.mark.parametrize(
    ("term", "flag"),
    [
        ("doors_locked", Inhibit.DOORS),
        ("platform_doors_locked", Inhibit.PLATFORM_DOORS),
        ("authority_ahead", Inhibit.AUTHORITY),
        ("not_held", Inhibit.HOLD),
        ("no_passenger_alarm", Inhibit.PASSENGER_ALARM),
        ("no_fire", Inhibit.FIRE),
        ("no_obstacle", Inhibit.OBSTACLE),
        ("awake", Inhibit.ASLEEP),
        ("no_emergency", Inhibit.EMERGENCY),
        ("centre_heard", Inhibit.CENTRE_SILENT),
    ],
)
def test_each_missing_term_is_named_by_a_flag_of_its_own(term: str, flag: Inhibit) -> None:
    assert inhibits(ALL._replace(**{term: False})) is flag


def test_an_unset_term_is_an_error_and_no_permission_to_depart() -> None:
    with pytest.raises(ValueError, match="longer"):
        inhibits(ALL[:-1])  # type: ignore[arg-type]


def test_a_jog_ignores_only_an_order_to_stay_and_the_end_of_authority() -> None:
    assert set(Inhibit(NOT_AGAINST_JOG)) == {Inhibit.HOLD, Inhibit.AUTHORITY}
