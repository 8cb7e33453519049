"""The keys of a scenario give line, mission, real train and assumed train."""

from importlib import resources
from pathlib import Path

import msgspec
import pytest

from firmware_py.settings import SettingsError
from metro_hil.model.case import Branch, Case, Setup
from metro_hil.model.case_setup import parts_of

SHIPPED = Path(str(resources.files("metro_hil.campaign.shipped")))
PLATFORMS = SHIPPED / "lines" / "platforms.toml"


def case(**keys: object) -> Case:
    setup = Setup(**keys)  # type: ignore[arg-type]
    return Case(id="s/1", index=0, scenario="s", seed=7, setup=setup)


def test_dwell_times_of_the_timetable_replace_those_of_the_line() -> None:
    line = parts_of(case(dwell_s={"II": 12.5})).journey.line

    assert line.station("II").dwell_s == 12.5
    assert line.station("I").dwell_s == 30.0


def test_plant_and_controller_get_the_same_line() -> None:
    parts = parts_of(case(dwell_s={"II": 12.5}))

    assert parts.scenario.line == parts.journey.line


def test_each_side_takes_the_stopping_point_for_the_length_that_it_knows() -> None:
    """At Island, trains up to 80 m stop at 270 m."""
    parts = parts_of(case(line=str(PLATFORMS), start="Yard", end="End", consist="hefei6"))

    assert parts.scenario.line.station("Island").stop_m == 300.0
    assert parts.journey.line.station("Island").stop_m == 270.0


def test_a_timetable_may_pass_stations() -> None:
    mission = parts_of(case(stops=("II", "IV"))).journey.mission

    assert [station.name for station in mission.stops] == ["II", "IV"]


def test_the_real_and_the_assumed_train_may_differ() -> None:
    parts = parts_of(
        case(
            real={"rotating_mass_percent": 9.0},
            believed={"train.rotating_mass_ratio": 0.05, "train.length_m": 70.0},
            odometer_error=0.03,
        )
    )

    assert parts.scenario.train.rotating_mass_percent == 9.0
    assert parts.config.train.rotating_mass_ratio == 0.05
    # The parameters of ATO follow from the controller's assumptions about the train.
    assert parts.config.ato.rotating_mass_percent == pytest.approx(5.0)
    assert parts.config.ato.train_length_m == 70.0
    assert parts.scenario.train.sensors.odometer_error_ratio.low == 0.03


def test_up_to_its_branch_a_case_uses_the_seed_of_the_branch() -> None:
    plain = case()
    branched = Case(
        id="s/1", index=0, scenario="s", seed=7, setup=Setup(), branch=Branch(seed=3, when="t_s>1")
    )

    assert parts_of(plain).scenario.seed == 7
    assert parts_of(branched).scenario.seed == 3


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"dwell_s": {"Il": 5.0}}, "dwell_s.Il: no such station; nearest valid value: I"),
        ({"dwell_s": {"II": -1.0}}, "dwell_s.II: -1 is not within 0..3600"),
        ({"stops": ("V",)}, "stops: V: not on the way"),
        ({"stops": ("I", "II")}, "stops: the last must be IV"),
        ({"desk_mode": "manuel"}, "desk_mode: 'manuel': nearest valid value: manual"),
        ({"start": "IV", "end": "I"}, "lies at 1500 m, not beyond IV"),
        ({"real": {"brake.servise.x": 1}}, "nearest valid key: service"),
        ({"believed": {"train.length": 70.0}}, "nearest valid key: length_m"),
        ({"line": "florenze"}, "florenze: nearest valid shipped name: florence"),
    ],
)
def test_inconsistent_keys_are_named(keys: dict[str, object], words: str) -> None:
    with pytest.raises(SettingsError) as raised:
        parts_of(case(**keys))

    assert words in str(raised.value)


def test_a_fault_of_a_part_that_the_train_lacks_is_refused_with_its_case() -> None:
    broken = msgspec.structs.replace(case(), faults=({"kind": "loop_break"},))
    with pytest.raises(SettingsError, match=r"s/1: fault\[0\]\.kind: loop_break: the train"):
        parts_of(broken)

    looped = Setup(real={"loop.connected": True})
    assert len(parts_of(msgspec.structs.replace(broken, setup=looped)).faults) == 1
