"""The power-limited law on the bench: on time, at the mark, within its power and speed limits."""

import json
from pathlib import Path

import numpy as np
import pytest

from metro_hil.cli.vobc import main
from metro_hil.model.log_columns import read_columns

RUN_S = 92.0
MASS_KG = 105100.0 * 1.02 + 11340.0


def test_one_hop_of_the_nanakuma_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    train = ["--consist", "nanakuma4", "--params", "nanakuma4", "--ato", "power_limited"]
    way = ["--line", "nanakuma", "--from", "Hashimoto", "--to", "Jiromaru"]

    assert (
        main(["run", "--lockstep", *way, *train, "--seed", "3", "--json", "--out", str(out)]) == 0
    )

    stop = json.loads(capsys.readouterr().out)["stops"][0]
    assert abs(stop["error_m"]) <= 0.10
    assert stop["run_time_s"] == pytest.approx(RUN_S, abs=3.0)
    truth = read_columns(out / "truth.csv")
    speed_mps, brake_n = truth.numbers("speed_mps"), truth.numbers("brake_force_n")
    traction_n = truth.numbers("traction_force_n")
    assert 10.0 < float(np.max(speed_mps)) < 18.5
    # The train coasts or brakes gently most of the way, without traction.
    fast = speed_mps > 10.0
    assert float(np.mean(traction_n[fast] < 1000.0)) > 0.5
    # At speed the brake stays far below the service brake's maximum of 1.1 m/s².
    assert float(np.max(brake_n[speed_mps > 12.0])) < 0.6 * 1.1 * MASS_KG
