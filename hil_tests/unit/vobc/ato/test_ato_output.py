"""Output stages: notches, the current loop, and stops in closed loop behind each of them."""

import itertools
import math
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py import settings
from firmware_py.settings import SettingsError
from metro_hil.model.run_options import parse
from metro_hil.run.lockstep import config_of
from vobc.ato import current_loop
from vobc.ato.output import CurrentLoop, Notches, make_stage
from vobc.ato.settings.output import STAGES, OutputStage
from vobc.cli.options import parser
from vobc.config import load_config

DT_S = 0.05
CONFIG = OutputStage(traction_levels_mps2=(0.2, 0.4, 0.6), brake_levels_mps2=(0.1, 0.3, 0.5, 0.8))
FINE = OutputStage()
LEVELS_MPS2 = (-0.8, -0.5, -0.3, -0.1, 0.0, 0.2, 0.4, 0.6)
WIDEST_MPS2 = 0.3
DEMANDS_MPS2 = st.floats(-0.8, 0.8)


def pick(stage: Notches, wanted_mps2: float, *, firm: bool = False) -> float:
    return stage.pick(wanted_mps2, DT_S, firm=firm)


def held_mps2(stage: Notches, wanted_mps2: float, cycles: int = 40) -> float:
    """The output that a stage settles on for a constant demand."""
    for _ in range(cycles):
        picked_mps2 = pick(stage, wanted_mps2)
    return picked_mps2


# Notches.


@pytest.mark.parametrize(
    ("asked_mps2", "picked_mps2"),
    [
        (0.0, 0.0),
        (0.2, 0.2),
        (0.199, 0.0),
        (0.39, 0.2),
        (0.8, 0.6),
        (-0.001, -0.1),
        (-0.1, -0.1),
        (-0.13, -0.1),
        (-0.29, -0.3),
        (-0.33, -0.3),
        (-0.8, -0.8),
        (-2.0, -0.8),
    ],
)
def test_the_stage_picks_the_nearest_brake_notch_or_the_next_lower_traction_notch(
    asked_mps2: float, picked_mps2: float
) -> None:
    assert held_mps2(Notches(CONFIG), asked_mps2) == picked_mps2


@given(st.lists(st.tuples(DEMANDS_MPS2, st.booleans()), min_size=1, max_size=200))
def test_the_output_is_always_a_notch_and_never_above_a_firm_demand(
    asked: list[tuple[float, bool]],
) -> None:
    stage = Notches(CONFIG)
    for asked_mps2, firm in asked:
        picked_mps2 = pick(stage, asked_mps2, firm=firm)

        assert picked_mps2 in LEVELS_MPS2
        assert not firm or picked_mps2 <= asked_mps2 + 1e-9


@given(st.lists(DEMANDS_MPS2, max_size=50), DEMANDS_MPS2)
def test_a_constant_demand_gets_a_notch_within_a_step_and_its_hysteresis(
    before: list[float], asked_mps2: float
) -> None:
    stage = Notches(CONFIG)
    for other_mps2 in before:
        pick(stage, other_mps2)

    missing_mps2 = asked_mps2 - held_mps2(stage, asked_mps2, cycles=100)

    assert abs(missing_mps2) < WIDEST_MPS2 * (1.0 + CONFIG.hysteresis_ratio) + 1e-9


@given(st.lists(st.sampled_from(LEVELS_MPS2), min_size=1, max_size=8))
def test_a_law_that_picks_notches_gets_each_at_once(picked: list[float]) -> None:
    stage = Notches(CONFIG)
    for notch_mps2 in picked:
        assert pick(stage, notch_mps2) == notch_mps2


def dwells_s(stage: Notches, wanted: Sequence[float]) -> list[float]:
    """Dwell time of each notch that another notch followed."""
    picked = [pick(stage, wanted_mps2) for wanted_mps2 in wanted]
    stays = [len(list(group)) * DT_S for _, group in itertools.groupby(picked)]
    return stays[1:-1]


def test_a_notch_stays_for_the_dwell_time_and_for_part_of_it_at_low_brake() -> None:
    waves = [0.5 + 0.09 * math.sin(0.1 * cycle) for cycle in range(1000)]
    strong = dwells_s(Notches(FINE), [-wanted_mps2 for wanted_mps2 in waves])
    light = dwells_s(Notches(FINE), [0.4 - wanted_mps2 for wanted_mps2 in waves])

    assert len(strong) > 3
    assert min(strong) >= FINE.dwell_s - 1e-9
    assert len(light) > 3
    assert 0.5 * FINE.dwell_s <= min(light) < FINE.dwell_s


def test_a_large_change_of_demand_skips_the_dwell_time() -> None:
    stage = Notches(FINE)
    held_mps2(stage, -0.35)

    assert pick(stage, -0.4) == -0.4
    assert pick(stage, -0.46) == -0.4
    assert pick(stage, -0.7) <= -0.65


@pytest.mark.parametrize(("trembles_mps2", "notches"), [(0.04, 1), (0.06, 2)])
def test_a_demand_that_oscillates_between_two_notches_changes_them_only_beyond_the_hysteresis(
    trembles_mps2: float, notches: int
) -> None:
    """The middle between 0.40 and 0.45 is 0.425. With a hysteresis of 0.4 * 0.05 the notch
    changes at 0.445."""
    stage = Notches(FINE)
    held_mps2(stage, -0.4)
    slow = [math.sin(cycle / 40.0) for cycle in range(1000)]

    picked = {pick(stage, -0.4 - trembles_mps2 * max(0.0, wave)) for wave in slow}

    assert len(picked) == notches


def test_the_notches_of_a_ramp_match_it_in_the_middle_of_their_dwell() -> None:
    """The mean output along a ramp equals the mean of the ramp. Without the look-ahead it would
    lag by half a dwell time."""
    stage = Notches(FINE)
    ramp = [-0.75 + 0.1 * DT_S * cycle for cycle in range(100)]
    held_mps2(stage, ramp[0])
    picked = [pick(stage, wanted_mps2) for wanted_mps2 in ramp]

    lag_mps2 = sum(ramp[20:]) / 80 - sum(picked[20:]) / 80

    assert abs(lag_mps2) < 0.025


def test_the_lowest_brake_notch_stays_while_any_brake_is_demanded() -> None:
    stage = Notches(CONFIG)
    held_mps2(stage, -0.05)

    assert {pick(stage, -0.05 + 0.0005 * cycle) for cycle in range(99)} == {-0.1}
    assert held_mps2(stage, 0.0) == 0.0


def test_a_firm_brake_demand_skips_the_dwell_time() -> None:
    stage = Notches(CONFIG)
    held_mps2(stage, -0.29)

    assert pick(stage, -0.31, firm=True) == -0.5
    assert pick(stage, -0.65, firm=True) == -0.8


def test_a_clock_that_stood_or_stepped_back_does_no_harm() -> None:
    stage = Notches(FINE)
    held_mps2(stage, -0.4)

    assert stage.pick(-0.41, 0.0, firm=False) == -0.4
    assert stage.pick(-0.41, -5.0, firm=False) == -0.4
    assert held_mps2(stage, -0.47, cycles=200) == -0.45


def test_between_notches_the_output_is_the_shaped_ramp() -> None:
    assert [Notches(CONFIG).step(demand_mps2, DT_S) for demand_mps2 in (0.13, -0.17)] == [
        0.13, -0.17,
    ]  # fmt: skip


# The current loop.


@pytest.mark.parametrize(
    ("read_ma", "traction_ratio", "brake_ratio"),
    [
        (0.0, 0.0, 0.0),
        (3.999, 0.0, 0.0),
        (4.0, 0.0, 0.0),
        (4.014, 0.001, 0.001),
        (11.0, 0.5, 0.5),
        (17.986, 0.999, 0.999),
        (18.0, 1.0, 1.0),
        (18.001, 1.0, 1.0),
        (20.0, 1.0, 1.0),
        (20.001, 0.0, 1.0),
        (24.0, 0.0, 1.0),
    ],
)
def test_currents_are_read_by_the_analogue_mapping(
    read_ma: float, traction_ratio: float, brake_ratio: float
) -> None:
    assert current_loop.traction_ratio(read_ma) == pytest.approx(traction_ratio)
    assert current_loop.brake_ratio(read_ma) == pytest.approx(brake_ratio)


@given(st.floats(0.0, 30.0), st.floats(0.0, 30.0))
def test_more_current_never_asks_for_less_brake_nor_within_the_range_for_less_traction(
    one_ma: float, other_ma: float
) -> None:
    low_ma, high_ma = sorted((one_ma, other_ma))

    assert current_loop.brake_ratio(low_ma) <= current_loop.brake_ratio(high_ma)
    if high_ma <= current_loop.RANGE_MA:
        assert current_loop.traction_ratio(low_ma) <= current_loop.traction_ratio(high_ma)


@given(DEMANDS_MPS2, st.integers(8, 24))
def test_the_converter_errs_to_the_safe_side_and_by_less_than_a_step(
    asked_mps2: float, bits: int
) -> None:
    stage = CurrentLoop(OutputStage(loop_bits=bits))
    step_mps2 = 20.0 / (2**bits - 1) / 14.0
    least_mps2 = 0.1 / 14.0 + step_mps2 if asked_mps2 < 0.0 else 0.0

    sent_mps2 = stage.step(asked_mps2, DT_S)

    # The converter rounds a current within a millionth of a step to that step.
    assert sent_mps2 <= asked_mps2 + 1e-6 * step_mps2 + 1e-12
    assert sent_mps2 >= min(asked_mps2 - step_mps2, -least_mps2) - 1e-9


@given(DEMANDS_MPS2, DEMANDS_MPS2)
def test_a_higher_demand_never_leaves_lower(one_mps2: float, other_mps2: float) -> None:
    stage = CurrentLoop(OutputStage())
    low_mps2, high_mps2 = sorted((one_mps2, other_mps2))

    assert stage.step(low_mps2, DT_S) <= stage.step(high_mps2, DT_S)


@given(DEMANDS_MPS2)
def test_currents_are_whole_counts_of_the_converter_and_one_loop_rests(asked_mps2: float) -> None:
    stage = CurrentLoop(OutputStage())
    stage.step(asked_mps2, DT_S)

    for current_ma in (stage.traction_ma, stage.brake_ma):
        counts = current_ma / 20.0 * 4095
        assert counts == pytest.approx(round(counts), abs=1e-6)
        assert 3.79 < current_ma < 18.01
    assert min(stage.traction_ma, stage.brake_ma) <= 3.8


def test_a_demand_beyond_full_scale_gives_full_scale() -> None:
    stage = CurrentLoop(OutputStage(loop_traction_full_mps2=0.5, loop_brake_full_mps2=0.7))

    assert stage.step(0.8, DT_S) == pytest.approx(0.5, abs=2e-4)
    assert stage.step(-0.8, DT_S) == pytest.approx(-0.7)


def test_the_continuous_stage_changes_nothing() -> None:
    stage = make_stage(OutputStage())

    assert [stage.step(asked_mps2, DT_S) for asked_mps2 in (0.123, -0.456)] == [0.123, -0.456]


# Settings and options.


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("hysteresis_ratio", 1.0),
        ("hysteresis_ratio", -0.1),
        ("dwell_s", -0.1),
        ("loop_bits", 7),
        ("loop_bits", 25),
        ("loop_traction_full_mps2", 0.0),
        ("loop_brake_full_mps2", 0.0),
    ],
)
def test_a_setting_that_makes_no_sense_is_refused(key: str, value: float) -> None:
    with pytest.raises(SettingsError, match=r"x\.toml"):
        settings.override(OutputStage(), {key: value}, "x.toml")


@pytest.mark.parametrize("stage", STAGES)
def test_the_command_line_chooses_the_stage(stage: str) -> None:
    config = config_of(parse(["run", "--lockstep", "--output", stage]))

    assert config.ato.output.stage == stage
    assert parser().parse_args(["--output", stage]).output == stage


def test_without_the_option_the_parameters_choose(capsys: pytest.CaptureFixture[str]) -> None:
    changes = {"ato.output.stage": "notches"}

    assert load_config("florence4").ato.output.stage == "continuous"
    assert load_config("florence4", changes=changes).ato.output.stage == "notches"
    assert load_config("florence4", stage="current_loop", changes=changes).ato.output.stage == (
        "current_loop"
    )
    with pytest.raises(SystemExit):
        parse(["run", "--output", "valve"])
    assert "invalid choice" in capsys.readouterr().err


def test_the_other_stages_pass_the_demand_through() -> None:
    for stage in (make_stage(OutputStage()), CurrentLoop(OutputStage())):
        assert stage.pick(0.123, DT_S, firm=False) == 0.123
        assert stage.pick(-0.456, DT_S, firm=True) == -0.456


# What goes to the module.


@pytest.mark.parametrize(
    ("force_n", "decel_mps2", "traction_ma", "brake_ma"),
    [
        (0.0, 0.0, 3.8, 3.8),
        (100_000.0, 0.0, 11.0, 3.8),
        (300_000.0, 0.0, 18.0, 3.8),
        (0.0, 0.5, 3.8, 11.0),
        (0.0, 2.0, 3.8, 18.0),
        (0.0, 0.001, 3.8, 4.1),
    ],
)
def test_force_and_deceleration_become_currents_within_a_step_of_the_converter(
    force_n: float, decel_mps2: float, traction_ma: float, brake_ma: float
) -> None:
    set_to = current_loop.reference(force_n, decel_mps2, inertia_kg=200_000.0, config=OutputStage())

    assert traction_ma - 20.0 / 4095 <= set_to.traction_ma <= traction_ma + 1e-9
    if brake_ma == 3.8:
        assert 3.8 - 20.0 / 4095 <= set_to.brake_ma <= 3.8
    else:
        assert brake_ma - 1e-9 <= set_to.brake_ma <= brake_ma + 20.0 / 4095


@given(st.integers(-1000, 1000).map(lambda step: step / 1000))
def test_the_current_for_the_output_of_the_stage_is_the_one_it_assumed(
    asked_mps2: float,
) -> None:
    stage = CurrentLoop(OutputStage())
    sent_mps2 = stage.step(asked_mps2, DT_S)
    inertia_kg = 167_600.0

    set_to = current_loop.reference(
        max(0.0, sent_mps2) * inertia_kg,
        max(0.0, -sent_mps2),
        inertia_kg=inertia_kg,
        config=OutputStage(),
    )

    assert (set_to.traction_ma, set_to.brake_ma) == (stage.traction_ma, stage.brake_ma)
