"""A recorded ride becomes a scenario: the fit finds the train that made the record, the scenario
runs, and a log that shows no ride gives one line."""

import json
import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Final

import pytest

from metro_hil.cli.hil import main
from metro_hil.from_log.fit import FittedKey, least_squares
from metro_hil.model.case import Case, Setup
from metro_hil.model.case_setup import parts_of
from metro_hil.model.run_folder import RunFolder
from metro_hil.run.lockstep import Lockstep

TRUE: Final = {
    "brake.service.gain_ratio": 0.9,
    "brake.service.dead_time_s": 0.6,
    "resistance.error_ratio": 0.15,
}
LOAD: Final = 0.9
ODOMETER_ERROR: Final = 0.03
NEAR: Final = {
    "brake.service.gain_ratio": 0.02,
    "brake.service.dead_time_s": 0.15,
    "resistance.error_ratio": 0.05,
}
"""How near the fit must come. The lag of the brake, which the record samples and the fit does not
know, moves the dead time by up to 0.125 s."""


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a ride with another load, odometer, brake and resistance than the consist has."""
    folder = tmp_path_factory.mktemp("field")
    setup = Setup(
        start="II", end="III", load_ratio=LOAD, odometer_error=ODOMETER_ERROR, real=dict(TRUE)
    )
    parts = parts_of(Case(id="x", index=0, scenario="x", seed=7, setup=setup))
    bench = Lockstep(parts.config, parts.scenario, parts.journey, RunFolder(folder))
    bench.run()
    bench.close()
    return RunFolder(folder).bus_log


def test_the_fit_finds_the_train_and_the_scenario_arrives(
    record: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "again"

    code = main(["from-log", str(record), "--out", str(out), "--json"])

    found = json.loads(capsys.readouterr().out)
    for key, true in TRUE.items():
        assert found["real"][key] == pytest.approx(true, abs=NEAR[key]), key
    assert found["load_ratio"] == pytest.approx(LOAD, abs=0.001)
    assert found["odometer_error"] == pytest.approx(ODOMETER_ERROR, abs=0.001)
    assert found["odometer_after_m"] < 0.1 * found["odometer_before_m"]
    assert found["result"]["verdict"] == "pass"
    assert found["comparison"]["signals"] > 30
    assert code == (1 if found["comparison"]["first"] else 0)
    scenario = tomllib.loads((out / "scenario.toml").read_text())
    assert scenario["train"]["real"] == found["real"]
    assert (scenario["train"]["start"], scenario["timetable"]["stops"]) == ("II", ["III"])


def _without(*identifiers: str) -> Callable[[list[str]], list[str]]:
    return lambda lines: [
        line for line in lines[:1500] if line.split()[2].partition("#")[0] not in identifiers
    ]


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        (_without("185"), [], "has no frame TACHO; "),
        (_without("102", "381"), [], "has no frame BRAKE_CMD and BRAKE_CMD_INV, no VOBC_POSITION"),
        (lambda lines: lines[:3000], [], "is too short: the train moves "),
        (lambda lines: lines[len(lines) // 2 :], [], "begin the log at a station"),
        (lambda lines: lines, ["--line", "hefei"], "name"),
        (
            lambda lines: [f"{each[:-4]}0000" for each in lines[:1500]],
            [],
            "are damaged; name a log of",
        ),
        (
            lambda lines: [*lines[:99], *(each.replace("vcan0", "vcan1") for each in lines[:99])],
            [],
            "channels vcan0, vcan1 have TACHO; name one by --channel",
        ),
    ],
    ids=["no odometer", "no controller", "short", "under way", "line", "damaged", "two channels"],
)
def test_a_log_without_a_usable_ride_gives_one_line(
    change: Callable[[list[str]], list[str]],
    options: list[str],
    words: str,
    record: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    log = tmp_path / "field.log"
    log.write_text("\n".join(change(record.read_text().splitlines())) + "\n")

    code = main(["from-log", str(log), *options, "--out", str(tmp_path / "out")])

    error = capsys.readouterr().err
    assert code == 2
    assert error.startswith("hil: ")
    assert error.count("\n") == 1
    assert words in error
    assert str(log) in error
    assert not (tmp_path / "out").exists()


def test_least_squares_finds_a_minimum_and_names_what_is_unseen() -> None:
    keys = [FittedKey(name, 1.0, 0.1, 0.0, 5.0, 3) for name in "abc"]

    def differences(values: "list[float]") -> list[float]:
        a, b, _ = values
        return [math.exp(a * t) - 2.0 * b * t - (math.exp(0.7 * t) - 4.0 * t) for t in range(5)]

    found = least_squares(keys, lambda values: differences(list(values)))

    assert found.values[:2] == pytest.approx([0.7, 2.0], abs=2e-3)
    assert found.values[2] == 1.0
    assert found.unseen == [2]
