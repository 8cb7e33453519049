"""The Green CBTC law on one train: the effect of its weights and of the line voltage on a run."""

import dataclasses
from typing import Any

import pytest

from firmware_py.trackdb import load_line
from hil_tests.unit.vobc.ato import ato_rig
from vobc.ato import Ato, AtoConfig
from vobc.ato.settings.green import Green

LINE = load_line("florence")
RUN_S = 105.0


class Powered(Ato):
    """An `Ato` with a line voltage that the rig does not know."""

    voltage_v: float | None = None

    def step(self, seen):  # type: ignore[no-untyped-def]
        return super().step(dataclasses.replace(seen, line_voltage_v=self.voltage_v))


def ride(law: str, voltage_v: float | None, **green: Any):  # type: ignore[no-untyped-def]
    """Run 1 km on the level from III to IV; return the stop and the speed in every cycle."""
    stations = tuple(
        dataclasses.replace(station, run_s=RUN_S if station.name == "IV" else 0.0)
        for station in LINE.stations
    )
    line = dataclasses.replace(LINE, stations=stations)
    config = AtoConfig(strategy=law, green=dataclasses.replace(Green(), **green))
    stops = [dataclasses.replace(line.station("IV"), dwell_s=2.0)]
    ato = Powered(config, line, 3500.0, stops)
    ato.voltage_v = voltage_v
    rig = ato_rig.Rig(ato, line, ato_rig.RigSettings(seed=3, start_scale_known=True), 3500.0)
    speeds: list[float] = []

    def watch(now) -> bool:  # type: ignore[no-untyped-def]
        if ato.strategy is not None:
            speeds.append(ato.strategy.speed_mps)
        return len(now.stops) >= 1

    rig.run(watch)
    return rig.stops[0], speeds


def test_without_weight_or_voltage_the_law_equals_the_timetable_law() -> None:
    timed, timed_mps = ride("timing", 830.0)

    for voltage_v, green in (
        (None, {}),
        (830.0, {"alpha_ratio": 1.0, "beta_ratio": 0.0}),
    ):
        stop, speeds_mps = ride("green", voltage_v, **green)
        assert stop.leg_s == pytest.approx(timed.leg_s, abs=0.01)
        assert speeds_mps == pytest.approx(timed_mps, abs=1e-6)


def test_a_high_voltage_speeds_the_train_up_and_a_low_one_slows_it_down_at_first() -> None:
    """The timing speed rises with the voltage and later makes up for what was lost at first."""
    high, high_mps = ride("green", 850.0)
    even, even_mps = ride("green", 750.0)
    low, low_mps = ride("green", 700.0)

    soon = slice(400, 900)
    assert sum(low_mps[soon]) < sum(even_mps[soon]) < sum(high_mps[soon])
    assert high.leg_s < even.leg_s
    assert max(low_mps) > max(even_mps)
    for stop in (high, even, low):
        assert abs(stop.error_m) <= 0.10
        assert stop.leg_s == pytest.approx(RUN_S, abs=4.0)


def test_a_configured_constant_voltage_overrides_the_measured_one() -> None:
    one, _ = ride("green", 850.0, constant_v=800.0)
    other, _ = ride("green", 700.0, constant_v=800.0)

    assert one.leg_s == other.leg_s


def test_the_printed_law_asks_for_full_traction_when_the_energy_reaches_the_target() -> None:
    printed, printed_mps = ride("green", 899.0, literal_target=True, horizon_s=60.0)
    weighed, weighed_mps = ride("green", 899.0, alpha_ratio=1.0, beta_ratio=0.0)

    assert max(printed_mps) > max(weighed_mps)
    assert printed.leg_s < weighed.leg_s


@pytest.mark.parametrize(
    "wrong", [{"alpha_ratio": 0.9}, {"horizon_s": 0.0}, {"constant_v": -1.0}, {"arm_ohm": 0.0}]
)
def test_settings_that_contradict_each_other_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        dataclasses.replace(Green(), **wrong)
