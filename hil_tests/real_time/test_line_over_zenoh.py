"""Trains as processes that command themselves over real zenoh."""

from pathlib import Path

from metro_hil.line.failover_trial import FailoverTrial


def test_a_killed_master_is_replaced_and_comes_back_as_a_member(tmp_path: Path) -> None:
    trial = FailoverTrial(3, "A", tmp_path)
    try:
        result = trial.fault("kill")
        master = trial.settle()
    finally:
        trial.close()

    assert result.all_served_ms is not None
    assert master in trial.seats
    assert {seat.taken[-1].term for seat in trial.seats.values()} == {
        trial.seats[master].taken[-1].term
    }
