"""Monitors in scenarios: the three forms, the default invariants, and every error."""

from typing import Any

import pytest

from firmware_py.settings import SettingsError
from metro_hil.monitors import MonitorKind, Severity, read_monitors
from metro_hil.monitors.catalogue import INVARIANTS, WATCHED


def read(*tables: dict[str, Any], invariants: object = "none", **more: Any) -> Any:
    return read_monitors(tables, "case.toml", invariants, **more)


def test_all_invariants_stand_by_themselves_and_carry_their_requirement() -> None:
    plans = read(invariants="all")

    assert [plan.name for plan in plans] == [each.name for each in WATCHED]
    assert {plan.kind for plan in plans} == {MonitorKind.INVARIANT}
    assert not any(plan.asked for plan in plans)
    by_name = {plan.name: plan for plan in plans}
    assert by_name["inv-04-civil-limit"].requirements == ("INV-04",)
    assert by_name["inv-04-civil-limit"].unit == "m/s"


@pytest.mark.parametrize("wanted", [30, "30", "inv-30", "INV-30"])
def test_a_number_means_all_parts_of_an_invariant(wanted: object) -> None:
    names = [f"inv-30-door-{part}" for part in ("speed", "place", "platform", "side")]

    assert [plan.name for plan in read(invariants=[wanted])] == names
    assert [plan.name for plan in read({"invariant": wanted})] == names


def test_one_that_is_asked_for_takes_the_place_of_the_standing_one() -> None:
    table = {"invariant": "inv-04-civil-limit", "requirements": ["ACC-05"], "name": "speed"}
    plans = read(table, invariants="all")

    found = [plan for plan in plans if plan.text == "inv-04-civil-limit"]
    assert [(plan.name, plan.asked) for plan in found] == [("speed", True)]
    assert found[0].requirements == ("INV-04", "ACC-05")


def test_a_formula_keeps_its_text_and_attributes() -> None:
    (plan,) = read(
        {
            "stl": "always(speed_mps <= 20)",
            "name": "slow",
            "unit": "m/s",
            "requirements": ["ACC-01"],
            "severity": "continue",
        }
    )

    assert (plan.name, plan.text, plan.unit) == ("slow", "always(speed_mps <= 20)", "m/s")
    assert (plan.requirements, plan.severity) == (("ACC-01",), Severity.CONTINUE)


def test_a_measure_names_itself_after_its_limits_and_takes_its_unit_from_its_name() -> None:
    (plan,) = read({"measure": "stop_error_worst_m", "min": 0, "max": 0.1})

    assert plan.name == "0 <= stop_error_worst_m <= 0.1"
    assert (plan.unit, plan.limits) == ("m", (0.0, 0.1))


def test_measures_are_checked_against_known_names_and_patterns() -> None:
    known = ("stop_error_worst_m", "stop_*_error_m")

    assert read({"measure": "stop_IV_error_m", "max": 1.0}, measures=known)
    with pytest.raises(SettingsError, match="nearest valid measure: stop_error_worst_m"):
        read({"measure": "stop_eror_worst_m", "max": 1.0}, measures=known)
    with pytest.raises(SettingsError, match="stop__error_m"):
        read({"measure": "stop__error_m", "max": 1.0}, measures=("stop_*_error_m",))


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({}, ["monitor[0]", "wants one of invariant, stl, measure", "none of them"]),
        ({"stl": "always(t_s >= 0)", "measure": "x"}, ["stl and measure exclude each other"]),
        ({"stl": "always(sped_mps <= 1)"}, ["monitor[0].stl", "unknown signal sped_mps",
                                            "nearest: speed_mps"]),
        ({"stl": "always(t_s >= 0)", "nam": "x"}, ["monitor[0].nam", "nearest valid key: name"]),
        ({"stl": "always(t_s >= 0)", "max": 3}, ["monitor[0].max", "unknown key"]),
        ({"stl": 3}, ["monitor[0].stl", "3 is not text"]),
        ({"stl": "always(t_s >= 0)", "unit": ""}, ["monitor[0].unit", "not text"]),
        ({"invariant": "inv-04-civil-limits"}, ["nearest valid value: inv-04-civil-limit"]),
        ({"invariant": 40}, ["40 is not watched", "neither truth"]),
        ({"invariant": 99}, ["99"]),
        ({"invariant": True}, ["True"]),
        ({"invariant": 30, "name": "doors"}, ["'doors'", "inv-30-door-speed"]),
        ({"measure": "x_m"}, ["wants min or max"]),
        ({"measure": "x_m", "max": "3"}, ["monitor[0].max", "'3' is not a number"]),
        ({"measure": "x_m", "max": True}, ["True is not a number"]),
        ({"measure": "x_m", "min": 3, "max": 2}, ["3 is over max, 2"]),
        ({"measure": "x_m", "max": 1, "requirements": "INV-01"}, ["is not a list of ids"]),
        ({"measure": "x_m", "max": 1, "requirements": ["inv 1"]}, ["not an id such as INV-04"]),
        ({"measure": "x_m", "max": 1, "severity": "stopp"}, ["nearest valid value: stop"]),
    ],
)  # fmt: skip
def test_an_error_is_reported_with_its_place_and_a_correction(
    table: dict[str, Any], words: list[str]
) -> None:
    with pytest.raises(SettingsError) as refused:
        read(table)

    assert str(refused.value).startswith("case.toml: monitor[0]")
    for word in words:
        assert word in str(refused.value)


@pytest.mark.parametrize("wrong", ["some", 3, ["inv-04", "nonsense"], [1.5]])
def test_default_invariants_are_all_none_or_known_ones(wrong: object) -> None:
    with pytest.raises(SettingsError, match=r"case\.toml: invariants: "):
        read(invariants=wrong)


def test_no_two_monitors_have_one_name() -> None:
    with pytest.raises(SettingsError, match="name of two monitors"):
        read(
            {"measure": "x_m", "max": 1.0, "name": "twin"},
            {"stl": "always(t_s >= 0)", "name": "twin"},
        )


def test_every_invariant_is_monitored_or_has_a_reason_why_not() -> None:
    assert sorted({each.number for each in INVARIANTS}) == list(range(1, 44))
    assert len({each.name for each in INVARIANTS}) == len(INVARIANTS)
    for each in INVARIANTS:
        assert bool(each.margin) == bool(each.unit) == each.watched, each.name
