"""Output stages: notches, the current loop, and stops in closed loop behind each of them."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py import settings
from firmware_py.settings import SettingsError
from metro_hil.lockstep import config_of
from metro_hil.options import parse
from vobc.ato import current_loop
from vobc.ato.output import CurrentLoop, Notches, make_stage
from vobc.ato.output_config import STAGES, OutputStage
from vobc.cli.options import parser
from vobc.config import load_config

DT_S = 0.05
CONFIG = OutputStage(traction_levels_mps2=(0.2, 0.4, 0.6), brake_levels_mps2=(0.1, 0.3, 0.5, 0.8))
LEVELS_MPS2 = (-0.8, -0.5, -0.3, -0.1, 0.0, 0.2, 0.4, 0.6)
WIDEST_MPS2 = 0.3
DEMANDS_MPS2 = st.floats(-0.8, 0.8)


def held_mps2(stage: Notches, demand_mps2: float, cycles: int = 40) -> float:
    """What a stage sends in the end for a demand that stays."""
    for _ in range(cycles):
        sent_mps2 = stage.step(demand_mps2, DT_S)
    return sent_mps2


# Notches.


@pytest.mark.parametrize(
    ("asked_mps2", "sent_mps2"),
    [
        (0.0, 0.0),
        (0.2, 0.2),
        (0.199, 0.0),
        (0.39, 0.2),
        (0.8, 0.6),
        (-0.001, -0.1),
        (-0.1, -0.1),
        (-0.101, -0.3),
        (-0.8, -0.8),
        (-2.0, -0.8),
    ],
)
def test_a_notch_is_never_more_traction_nor_less_brake_than_asked(
    asked_mps2: float, sent_mps2: float
) -> None:
    assert held_mps2(Notches(CONFIG), asked_mps2) == sent_mps2


@given(st.lists(DEMANDS_MPS2, min_size=1, max_size=200))
def test_whatever_is_asked_what_leaves_is_a_notch_at_or_below_it(asked: list[float]) -> None:
    stage = Notches(CONFIG)
    for asked_mps2 in asked:
        sent_mps2 = stage.step(asked_mps2, DT_S)

        assert sent_mps2 in LEVELS_MPS2
        assert sent_mps2 <= asked_mps2 + 1e-9


@given(st.lists(DEMANDS_MPS2, max_size=50), DEMANDS_MPS2)
def test_a_demand_that_stays_gets_a_notch_within_a_step_and_its_hysteresis(
    before: list[float], asked_mps2: float
) -> None:
    stage = Notches(CONFIG)
    for other_mps2 in before:
        stage.step(other_mps2, DT_S)

    missing_mps2 = asked_mps2 - held_mps2(stage, asked_mps2)

    assert missing_mps2 < WIDEST_MPS2 * (1.0 + CONFIG.hysteresis_ratio) + 1e-9


@given(st.lists(st.sampled_from(LEVELS_MPS2), min_size=1, max_size=8))
def test_a_law_that_picks_notches_gets_each_as_it_is(picked: list[float]) -> None:
    stage = Notches(CONFIG)
    for notch_mps2 in picked:
        assert held_mps2(stage, notch_mps2, cycles=len(LEVELS_MPS2) + 1) == notch_mps2


@given(st.lists(st.integers(-80, 80).map(lambda step: step / 100 + 0.005), min_size=2))
def test_after_a_step_down_no_step_up_before_the_dwell_time_is_over(asked: list[float]) -> None:
    stage = Notches(CONFIG)
    sent = [stage.step(asked_mps2, DT_S) for asked_mps2 in asked]
    down_at = -1000
    for cycle, (before_mps2, after_mps2) in enumerate(itertools.pairwise([0.0, *sent])):
        if after_mps2 < before_mps2:
            down_at = cycle
        elif after_mps2 > before_mps2:
            assert (cycle - down_at) * DT_S >= CONFIG.dwell_s - 1e-9


def test_a_demand_that_trembles_about_a_notch_does_not_make_it_chatter() -> None:
    stage = Notches(CONFIG)
    held_mps2(stage, 0.38)

    sent = [stage.step(0.4 + 0.03 * (-1) ** cycle, DT_S) for cycle in range(100)]

    assert set(sent) == {0.2}


def test_the_least_brake_notch_stays_as_long_as_anything_is_asked_of_the_brake() -> None:
    stage = Notches(CONFIG)
    held_mps2(stage, -0.05)

    assert {stage.step(-0.05 + 0.0005 * cycle, DT_S) for cycle in range(99)} == {-0.1}
    assert held_mps2(stage, 0.0) == 0.0


def test_a_ramp_of_demand_goes_out_notch_by_notch() -> None:
    stage = Notches(CONFIG)
    ramp = [-0.8 + 0.03 * cycle for cycle in range(50)]
    sent = [stage.step(asked_mps2, DT_S) for asked_mps2 in (*ramp, *reversed(ramp))]

    indices = [LEVELS_MPS2.index(sent_mps2) for sent_mps2 in sent]

    assert set(indices) == set(range(len(LEVELS_MPS2)))
    assert all(abs(after - before) <= 1 for before, after in itertools.pairwise(indices[1:]))


def test_a_release_that_waited_goes_out_one_notch_a_cycle() -> None:
    stage = Notches(CONFIG)
    stage.step(-0.8, DT_S)

    sent = [stage.step(0.55, DT_S) for _ in range(12)]

    assert sent == [-0.8] * 5 + [-0.5, -0.3, -0.1, 0.0, 0.2, 0.4, 0.4]


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

    # A current within a millionth of a step counts as it.
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


def test_more_than_full_is_full() -> None:
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
    assert parser().parse_args(["run", "--output", stage]).output == stage


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
