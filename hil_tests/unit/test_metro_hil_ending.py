"""When a run ends by itself because its train stands in emergency for good."""

import pytest

from can_dbc.vobc import Cause, Supervision
from metro_hil.ending import UNATTENDED_S, EmergencyWatch

S = 1_000_000_000
LONG_NS = round(UNATTENDED_S * S)


def asked(watch: EmergencyWatch, now_ns: int, supervision: Supervision) -> str | None:
    return watch.stands_for_good(now_ns, supervision, Cause.VITAL_INPUT_LOST)


def test_an_emergency_that_stays_ends_the_run_and_names_its_cause() -> None:
    watch = EmergencyWatch()

    assert asked(watch, 5 * S, Supervision.EMERGENCY) is None
    assert asked(watch, 5 * S + LONG_NS - 1, Supervision.EMERGENCY) is None
    words = asked(watch, 5 * S + LONG_NS, Supervision.EMERGENCY)

    assert words is not None
    assert "vital input lost" in words
    assert "30 s" in words


def test_one_that_is_let_go_in_time_does_not_and_the_next_counts_anew() -> None:
    watch = EmergencyWatch()

    asked(watch, 0, Supervision.EMERGENCY)
    assert asked(watch, LONG_NS - 1, Supervision.NOMINAL) is None
    assert asked(watch, LONG_NS, Supervision.EMERGENCY) is None
    assert asked(watch, 2 * LONG_NS - 1, Supervision.EMERGENCY) is None
    assert asked(watch, 2 * LONG_NS, Supervision.EMERGENCY) is not None


@pytest.mark.parametrize("state", sorted({*Supervision} - {Supervision.EMERGENCY}))
def test_no_other_state_ends_it(state: Supervision) -> None:
    watch = EmergencyWatch()

    assert asked(watch, 0, state) is None
    assert asked(watch, 10 * LONG_NS, state) is None
