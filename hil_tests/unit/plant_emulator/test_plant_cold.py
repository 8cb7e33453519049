"""The cold-movement detector: which movements it counts."""

from hypothesis import given
from hypothesis import strategies as st

from can_dbc.odometer import ColdMovement
from plant_emulator.sensors.cold import ColdDetector


def test_a_train_that_stands_until_the_first_command_was_not_moved() -> None:
    cold = ColdDetector(100.0)
    cold.look(100.0, silent=False)
    cold.attended(100.0)
    assert cold.frame() == ColdMovement(moved_m=0.0, monitored=True)


def test_movement_before_the_first_command_counts_in_both_directions() -> None:
    for front_m in (103.5, 96.5):
        cold = ColdDetector(100.0)
        cold.look(front_m, silent=False)
        cold.look(100.0, silent=False)
        cold.attended(100.0)
        assert cold.frame().moved_m == 3.5, "the largest distance, not the last one"


@given(st.lists(st.floats(-500.0, 500.0), max_size=30))
def test_movement_under_an_active_controller_does_not_count(
    fronts_m: list[float],
) -> None:
    cold = ColdDetector(0.0)
    cold.attended(0.0)
    for front_m in fronts_m:
        cold.attended(front_m)
        cold.look(front_m, silent=False)
    assert cold.frame().moved_m == 0.0


def test_the_count_starts_at_the_last_command_and_stays_when_the_controller_returns() -> None:
    cold = ColdDetector(0.0)
    for front_m in (0.0, 10.0, 20.0):
        cold.attended(front_m)
    cold.look(23.0, silent=True)
    cold.look(31.0, silent=True)
    cold.attended(32.0)
    cold.look(40.0, silent=False)
    assert cold.frame().moved_m == 12.0


def test_the_next_absence_restarts_the_count() -> None:
    cold = ColdDetector(0.0)
    cold.attended(0.0)
    cold.look(9.0, silent=True)
    cold.attended(9.0)
    cold.look(9.5, silent=True)
    assert cold.frame().moved_m == 0.5
