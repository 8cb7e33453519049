"""The driver's desk: keys, recordings, driver models, and the screen."""

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.binding import Frame
from can_dbc.cab import CabMode, Desk
from can_dbc.doors import DoorCars, DoorCommand
from can_dbc.vobc import (
    AtoPhase,
    Cause,
    Inhibit,
    Intervention,
    Missing,
    OperatingMode,
    ReasonCode,
    Supervision,
    TargetKind,
    VobcLimits,
    VobcMode,
    VobcMotion,
    VobcPosition,
    VobcStatus,
    VobcSupervision,
    VobcTarget,
    Withheld,
)
from firmware_py.settings import SettingsError
from plant_emulator.cli.terminal import key_names
from plant_emulator.desk.attendant import attendant
from plant_emulator.desk.display import FRESH_NS, SCREEN_KINDS, DeskDisplay
from plant_emulator.desk.dmi import StatusColour, colour_of, dial, target_text
from plant_emulator.desk.drivers import DRIVERS, Driver, Trend
from plant_emulator.desk.hands import KEYS, PRESS_NS, Hands, press, unattended
from plant_emulator.desk.recording import (
    FIELDS,
    DeskRecording,
    change_line,
    load_recording,
    parse_recording,
)
from plant_emulator.desk.screen import HEIGHT, WIDTH, lines, status_colour
from plant_emulator.world import plan_scenario

MANUAL = unattended(CabMode.MANUAL)
STATUS = VobcStatus(
    supervision=Supervision.NOMINAL,
    ato_phase=AtoPhase.OFF,
    missing=Missing.NOTHING,
    localised=True,
    slip_detected=False,
    work_us=0.0,
    cycle_slips=0,
)
MODE = VobcMode(
    mode=OperatingMode.AUTHORISED,
    cause=Cause.NONE,
    departure_inhibits=Inhibit.NONE,
    doors_withheld=Withheld.MOVING,
    jog_attempts=0,
    replicas_agree=True,
    alarm_raised=False,
)
NS_PER_S = 1_000_000_000
DESKS = st.builds(
    Desk,
    st.sampled_from(CabMode),
    st.integers(-500, 500).map(lambda fifths: fifths / 5.0),
    *[st.booleans() for _ in range(8)],
)


def shown(
    speed_mps: float, ceiling_mps: float, emergency_mps: float, now_ns: int = 0
) -> DeskDisplay:
    display = DeskDisplay()
    display.hear(STATUS, now_ns)
    display.hear(VobcMotion(speed_mps, ceiling_mps, emergency_mps), now_ns)
    return display


def told(
    intervention: Intervention = Intervention.NONE,
    kind: TargetKind = TargetKind.NONE,
    target_mps: float = 0.0,
    target_distance_m: float = 6000.0,
) -> VobcSupervision:
    reason = ReasonCode.NONE if intervention is Intervention.NONE else ReasonCode.ROLLBACK
    return VobcSupervision(intervention, reason, kind, target_mps, target_distance_m)


def pressed(*keys: str, at_ns: int = 0) -> Hands:
    hands = Hands(MANUAL)
    for key in keys:
        hands = press(hands, key, at_ns)
    return hands


def test_the_lever_moves_by_tenths_and_stops_at_its_ends() -> None:
    assert pressed("up", "up", "down").desk.lever_percent == 10.0
    assert pressed(*["up"] * 30).desk.lever_percent == 100.0
    assert pressed(*["down"] * 30).desk.lever_percent == -100.0
    assert pressed("up", "b").desk.lever_percent == -100.0
    assert pressed("b", "space").desk.lever_percent == 0.0


@pytest.mark.parametrize(
    ("key", "field"),
    [
        ("e", "emergency_released"),
        ("p", "no_passenger_alarm"),
        ("left", "open_left_requested"),
        ("right", "open_right_requested"),
        ("x", "restricted_requested"),
        ("y", "door_bypass_requested"),
    ],
)
def test_each_switch_toggles_and_affects_nothing_else(key: str, field: str) -> None:
    once = pressed(key).desk
    assert once == replace(MANUAL, **{field: not getattr(MANUAL, field)})  # type: ignore[arg-type]
    assert pressed(key, key).desk == MANUAL


@pytest.mark.parametrize(("key", "field"), [("d", "departure_requested"), ("r", "reset_requested")])
def test_buttons_spring_back_after_a_second(key: str, field: str) -> None:
    hands = pressed(key, at_ns=5)
    assert getattr(hands.at(5 + PRESS_NS - 1), field)
    assert not getattr(hands.at(5 + PRESS_NS), field)


def test_the_key_turns_and_ends_the_desk() -> None:
    modes = [pressed(key).desk.mode for key in "amo"]
    assert modes == [CabMode.AUTO, CabMode.MANUAL, CabMode.OFF]
    assert pressed("q").gone
    assert not pressed("z", "up").gone


@given(desks=st.lists(DESKS, min_size=1, max_size=8))
def test_a_recording_is_played_back_unchanged(desks: list[Desk]) -> None:
    before: Desk | None = None
    text = "# anything\n"
    for second, desk in enumerate(desks):
        text += change_line(float(second), before, desk)
        before = desk

    recording = parse_recording(text, "test")

    for second, desk in enumerate(desks):
        assert recording.at(second + 0.5, MANUAL) == desk


def test_before_its_first_line_a_recording_does_not_change_the_desk() -> None:
    recording = parse_recording("2.5 lever_percent=40 reset_requested=true\n", "test")
    assert recording.at(2.499, MANUAL) == MANUAL
    assert recording.at(2.5, MANUAL) == replace(MANUAL, lever_percent=40.0, reset_requested=True)
    assert recording.end_s == 2.5
    assert DeskRecording(()).at(9.0, MANUAL) == MANUAL


def test_only_changes_are_recorded() -> None:
    assert change_line(1.0, MANUAL, MANUAL) == ""
    assert change_line(1.0, MANUAL, replace(MANUAL, lever_percent=20.0)) == (
        "1.000 lever_percent=20\n"
    )
    assert change_line(0.0, None, MANUAL).count("=") == len(FIELDS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("soon mode=auto", "a.desk:1: t_s: 'soon' is not a number of seconds"),
        ("nan mode=auto", "a.desk:1: t_s: 'nan'"),
        ("-1 mode=auto", "a.desk:1: t_s: '-1'"),
        ("\n2 mode=auto\n1 mode=off", "a.desk:3: t_s: 1 is before 2"),
        ("1 leaver_percent=5", "a.desk:1: leaver_percent: unknown key; nearest valid key: lever_"),
        ("1 lever_percent=101", "a.desk:1: lever_percent: '101' is not a number in -100..100"),
        ("1 lever_percent=full", "a.desk:1: lever_percent: 'full' is not"),
        ("1 lever_percent", "a.desk:1: lever_percent: no value; write lever_percent=..."),
        ("1 reset_requested=yes", "a.desk:1: reset_requested: 'yes' is neither true nor false"),
        ("1 mode=manuel", "a.desk:1: mode: 'manuel': nearest valid"),
        ("1", "a.desk:1: nothing changes at 1 s"),
    ],
)
def test_an_unplayable_line_is_reported_with_file_line_and_key(text: str, words: str) -> None:
    with pytest.raises(SettingsError) as refused:
        parse_recording(text, "a.desk")
    assert words in str(refused.value)


def test_a_missing_or_binary_recording_is_reported(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"nowhere\.desk: no such file"):
        load_recording(str(tmp_path / "nowhere.desk"))
    path = tmp_path / "binary.desk"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SettingsError, match=r"binary\.desk: cannot be read"):
        load_recording(str(path))


def test_only_one_source_can_operate_the_desk(tmp_path: Path) -> None:
    path = tmp_path / "a.desk"
    path.write_text("0 mode=manual\n", encoding="utf-8")
    assert plan_scenario(desk_recording=str(path)).desk_recording is not None
    assert plan_scenario(driver="late").driver == "late"
    with pytest.raises(SettingsError, match="choose only one operator of the desk"):
        plan_scenario(driver="late", desk_recording=str(path))
    with pytest.raises(SettingsError, match="driver: 'ruthless'"):
        plan_scenario(driver="ruthless")


def test_the_desk_may_be_unattended() -> None:
    assert attendant(None, None, mode=CabMode.AUTO, start_ns=0) is None


def test_a_recording_counts_from_the_start_of_the_run() -> None:
    recording = parse_recording("1 lever_percent=-30", "test")
    play = attendant(None, recording, mode=CabMode.MANUAL, start_ns=7 * NS_PER_S)
    assert play is not None
    assert play(DeskDisplay(), 8 * NS_PER_S - 1) == MANUAL
    assert play(DeskDisplay(), 8 * NS_PER_S).lever_percent == -30.0


def lever(driver: Driver, display: DeskDisplay, now_ns: int = 0) -> float:
    desk = driver.drive(display, now_ns)
    assert desk.mode is CabMode.MANUAL
    assert -100.0 <= desk.lever_percent <= 100.0
    return desk.lever_percent


@given(
    speed_mps=st.floats(-5.0, 40.0), ceiling_mps=st.floats(0.0, 30.0), over_mps=st.floats(0.0, 5.0)
)
def test_a_reckless_driver_never_releases_the_lever(
    speed_mps: float, ceiling_mps: float, over_mps: float
) -> None:
    display = shown(speed_mps, ceiling_mps, ceiling_mps + over_mps)
    assert lever(DRIVERS["reckless"](), display) == 100.0


@given(speed_mps=st.floats(0.0, 40.0), ceiling_mps=st.floats(0.0, 30.0))
def test_an_obedient_driver_uses_no_traction_at_or_above_the_permitted_speed(
    speed_mps: float, ceiling_mps: float
) -> None:
    pull_percent = lever(DRIVERS["obedient"](), shown(speed_mps, ceiling_mps, ceiling_mps + 2.0))
    if speed_mps >= ceiling_mps:
        assert pull_percent < 0.0
    if speed_mps < ceiling_mps - 2.0:
        assert pull_percent > 0.0


def test_an_obedient_driver_brakes_before_a_limit_that_falls() -> None:
    driver, now_ns = DRIVERS["obedient"](), 0
    pulls_percent = []
    for tenth in range(10):
        now_ns = tenth * NS_PER_S // 10
        display = shown(10.0, 14.0 - 0.08 * tenth, 16.0, now_ns)
        pulls_percent.append(lever(driver, display, now_ns))
    assert pulls_percent[0] == 100.0
    assert pulls_percent[-1] < pulls_percent[0]


@pytest.mark.parametrize(("left_m", "wanted_mps"), [(20.0, 0.0), (120.0, 10.0), (245.0, 15.0)])
def test_an_obedient_driver_brakes_gently_before_the_end_of_the_authority(
    left_m: float, wanted_mps: float
) -> None:
    """At 0.5 m/s² these speeds stop 20 m before the end."""
    pulls_percent = []
    for speed_mps in (wanted_mps - 0.1, wanted_mps + 0.1):
        display = shown(speed_mps, 19.0, 21.0)
        display.hear(VobcTarget(distance_to_stop_m=0.0, distance_to_authority_m=left_m), 0)
        pulls_percent.append(lever(DRIVERS["obedient"](), display))
    assert pulls_percent[1] < 0.0
    assert pulls_percent[0] > 0.0 or wanted_mps == 0.0


@pytest.mark.parametrize("name", ["obedient", "late"])
def test_a_driver_without_a_speed_display_brakes(name: str) -> None:
    driver, display = DRIVERS[name](), shown(5.0, 15.0, 17.0)
    assert lever(driver, DeskDisplay()) == -100.0
    assert lever(driver, display, FRESH_NS) > 0.0
    assert lever(driver, display, FRESH_NS + 1) == -100.0


def test_an_obedient_driver_presses_reset_at_standstill_and_releases_the_button() -> None:
    driver, seen = DRIVERS["obedient"](), set()
    for speed_mps in (5.0, 0.0):
        display = shown(speed_mps, 0.0, 0.0)
        display.hear(replace(STATUS, supervision=Supervision.EMERGENCY), 0)
        for tenth in range(60):
            now_ns = tenth * NS_PER_S // 10
            display.hear(VobcMotion(speed_mps, 0.0, 0.0), now_ns)
            desk = driver.drive(display, now_ns)
            assert desk.lever_percent == -100.0
            seen.add((speed_mps, desk.reset_requested))
    assert seen == {(5.0, False), (0.0, False), (0.0, True)}


def test_a_late_driver_brakes_at_the_emergency_limit_and_accelerates_again_below_it() -> None:
    driver = DRIVERS["late"]()
    assert lever(driver, shown(15.0, 14.0, 16.0)) == 100.0, "over the permitted speed"
    assert lever(driver, shown(15.6, 14.0, 16.0)) == -100.0
    assert lever(driver, shown(14.6, 14.0, 16.0)) == -100.0
    assert lever(driver, shown(14.4, 14.0, 16.0)) == 100.0


@pytest.mark.parametrize(
    ("limits_mps", "fall_mps2"),
    [([10.0, 9.9], 1.0), ([10.0, 10.1], 0.0), ([10.0, 9.0], 0.0), ([10.0], 0.0)],
)
def test_a_limit_counts_as_falling_when_approached_and_not_when_replaced(
    limits_mps: list[float], fall_mps2: float
) -> None:
    trend = Trend()
    falls = [trend.fall_mps2(mps, n * NS_PER_S // 10) for n, mps in enumerate(limits_mps)]
    assert falls[-1] == pytest.approx(fall_mps2)
    assert trend.fall_mps2(limits_mps[-1], 5 * NS_PER_S) == 0.0, "it has stopped falling"


def test_the_screen_shows_the_controllers_messages() -> None:
    display = shown(10.0, 15.0, 17.0)
    display.hear(replace(MODE, mode=OperatingMode.JOG, jog_attempts=2, alarm_raised=True), 0)
    display.hear(replace(STATUS, missing=Missing.AUTHORITY | Missing.DOORS), 0)
    display.hear(VobcPosition(front_m=1234.5, uncertainty_m=2.5), 0)
    display.hear(VobcTarget(distance_to_stop_m=50.0, distance_to_authority_m=321.0), 0)
    text = "\n".join(lines(display, replace(MANUAL, reset_requested=True), 0))
    for words in (
        *("36.0 km/h", "permitted 54.0", "emergency 61.2", "jog 2  ALARM", "nominal", "MANUAL"),
        *("doors, authority", "moving", "1234.5 m ± 2.5 m", "321 m", "reset"),
    ):
        assert words in text
    assert all(words in text for _, words, _ in KEYS)


@pytest.mark.parametrize(
    ("speed_mps", "inhibits", "words"),
    [
        (0.0, Inhibit.NONE, "departure  permitted"),
        (0.0, Inhibit.HOLD, "departure  hold"),
        (0.5, Inhibit.NONE, "departure  --"),
        (-0.5, Inhibit.HOLD, "departure  --"),
    ],
)
def test_the_screen_shows_departure_inhibits_only_at_standstill(
    speed_mps: float, inhibits: Inhibit, words: str
) -> None:
    display = shown(speed_mps, 15.0, 17.0)
    display.hear(replace(MODE, departure_inhibits=inhibits), 0)
    assert words in "\n".join(lines(display, MANUAL, 0))


@pytest.mark.parametrize(
    ("left", "right", "withheld", "words"),
    [
        (False, False, Withheld.NONE, "doors  --"),
        (False, False, Withheld.MISALIGNED, "doors  misaligned"),
        (True, False, Withheld.NONE, "doors  enabled left"),
        (False, True, Withheld.NONE, "doors  enabled right"),
        (True, True, Withheld.NONE, "doors  enabled left and right"),
    ],
)
def test_the_screen_calls_doors_enabled_only_when_a_side_is(
    left: bool, right: bool, withheld: Withheld, words: str
) -> None:
    display = shown(0.0, 15.0, 17.0)
    display.hear(replace(MODE, doors_withheld=withheld), 0)
    display.hear(DoorCommand(left, right, open_left=False, open_right=False), 0)
    (drawn,) = (line for line in lines(display, MANUAL, 0) if line.strip().startswith("doors "))
    assert words in drawn


@pytest.mark.parametrize(
    ("typed", "names"),
    [
        (b"d", ["d"]),
        (b"M ", ["m", "space"]),
        (b"\x1b[A\x1bOB", ["up", "down"]),
        (b"\x1b[1;5D", []),
        (b"\x1b[15~q", ["q"]),
        (b"\x1bOPq", ["q"]),
        (b"\x1bdq", ["q"]),
        (b"\x1b", []),
        (b"\x1b[", []),
    ],
)
def test_an_escape_sequence_is_one_key_and_never_a_letter_of_the_desk(
    typed: bytes, names: list[str]
) -> None:
    assert list(key_names(typed)) == names


@given(
    speed_mps=st.floats(-400.0, 400.0),
    inhibits=st.integers(0, 1023).map(Inhibit),
    withheld=st.integers(0, 1023).map(Withheld),
    cause=st.sampled_from(Cause),
    desk=DESKS,
    heard=st.booleans(),
)
def test_the_screen_always_fits(
    speed_mps: float, inhibits: Inhibit, withheld: Withheld, cause: Cause, desk: Desk, heard: bool
) -> None:
    display = DeskDisplay()
    if heard:
        display = shown(speed_mps, 22.0, 24.0)
        mode = replace(MODE, departure_inhibits=inhibits, doors_withheld=withheld, cause=cause)
        display.hear(mode, 0)
        display.hear(VobcLimits(23.0, 23.5), 0)
        display.hear(told(Intervention.EMERGENCY_BRAKE, TargetKind.END, 0.0, -500.0), 0)
        display.hear(VobcPosition(front_m=-1e6, uncertainty_m=1e6), 0)
    drawn = lines(display, desk, 0, note="x" * 200)
    assert len(drawn) <= HEIGHT < 24
    assert all(len(line) <= WIDTH < 80 and line.isprintable() for line in drawn)


def test_a_silent_controller_blanks_the_screen_and_is_shown_with_its_age() -> None:
    display = shown(10.0, 12.0, 13.0)
    display.hear(MODE, 0)
    display.hear(VobcPosition(front_m=1234.5, uncertainty_m=2.5), 0)
    display.hear(VobcTarget(distance_to_stop_m=50.0, distance_to_authority_m=321.0), 0)
    display.hear(DoorCommand(True, False, open_left=False, open_right=False), 0)

    before = "\n".join(lines(display, MANUAL, FRESH_NS)).lower()
    after = "\n".join(lines(display, MANUAL, 8 * NS_PER_S)).lower()

    for words in ("nominal", "authorised", "36.0", "1234.5", "321", "enabled left"):
        assert words in before, words
        assert words not in after, words
    assert "silent" not in before
    assert "controller silent for 8 s" in after


def test_a_missing_frame_blanks_only_its_own_values() -> None:
    display = shown(10.0, 12.0, 13.0, now_ns=3 * NS_PER_S)
    display.hear(VobcPosition(front_m=1234.5, uncertainty_m=2.5), 0)

    text = "\n".join(lines(display, MANUAL, 3 * NS_PER_S))

    assert "VOBC_POSITION silent for 3 s" in text
    assert "1234.5" not in text
    assert "36.0" in text


def test_before_the_first_frame_the_screen_reports_that_none_came() -> None:
    text = "\n".join(lines(DeskDisplay(), MANUAL, 0)).lower()

    assert "no frame from the controller yet" in text
    assert "silent" not in text


@given(age_ns=st.integers(0, 20 * NS_PER_S), kind=st.sampled_from(SCREEN_KINDS))
def test_a_frame_is_shown_while_it_is_fresh(age_ns: int, kind: type[Frame]) -> None:
    frames: dict[type[Frame], Frame] = {
        VobcStatus: STATUS,
        VobcMode: MODE,
        VobcMotion: VobcMotion(1.0, 2.0, 3.0),
        VobcPosition: VobcPosition(front_m=1.0, uncertainty_m=2.0),
        VobcTarget: VobcTarget(distance_to_stop_m=1.0, distance_to_authority_m=2.0),
        VobcLimits: VobcLimits(2.0, 3.0),
        VobcSupervision: told(),
        DoorCommand: DoorCommand(True, False, open_left=False, open_right=False),
        DoorCars: DoorCars(left_cars=1, right_cars=0),
    }
    display = DeskDisplay()
    display.hear(frames[kind], 7)

    shown_frame = display.latest(kind, 7 + age_ns)

    assert shown_frame == (frames[kind] if age_ns <= FRESH_NS else None)
    assert bool(display.silence(7 + age_ns)) is (age_ns > FRESH_NS)


def test_an_obedient_driver_ignores_a_target_that_the_display_blanked() -> None:
    """The train is close to the end of authority: with the target the driver brakes, without it
    he drives on."""
    now_ns = 2 * NS_PER_S
    near = VobcTarget(distance_to_stop_m=0.0, distance_to_authority_m=21.0)
    fresh, stale = (shown(5.0, 20.0, 22.0, now_ns=now_ns) for _ in range(2))
    fresh.hear(near, now_ns)
    stale.hear(near, 0)

    lever_percents = [DRIVERS["obedient"]().drive(d, now_ns).lever_percent for d in (fresh, stale)]

    assert lever_percents[0] < 0.0 < lever_percents[1]


@pytest.mark.parametrize(
    ("speed_mps", "supervision", "colour"),
    [
        (10.0, told(), "grey"),
        (0.0, told(kind=TargetKind.END), "grey"),
        (5.0, told(kind=TargetKind.LINE_LIMIT, target_mps=5.0), "grey"),
        (5.1, told(kind=TargetKind.LINE_LIMIT, target_mps=5.0), "white"),
        (13.0, told(kind=TargetKind.END), "white"),
        (13.1, told(kind=TargetKind.END), "yellow"),
        (-13.1, told(kind=TargetKind.END), "yellow"),
        (15.0, told(kind=TargetKind.END), "yellow"),
        (15.01, told(), "orange"),
        (14.0, told(Intervention.WARNING), "orange"),
        (14.0, told(Intervention.NO_TRACTION), "grey"),
        (14.0, told(Intervention.SERVICE_BRAKE), "red"),
        (0.0, told(Intervention.EMERGENCY_BRAKE), "red"),
    ],
)
def test_the_speed_has_the_status_colour_of_a_dmi(
    speed_mps: float, supervision: VobcSupervision, colour: str
) -> None:
    assert colour_of(VobcMotion(speed_mps, 15.0, 17.0), supervision).shown == colour


def test_a_creeping_train_without_a_permitted_speed_is_over_it() -> None:
    assert colour_of(VobcMotion(0.05, 0.0, 0.0), told()).shown == "grey"
    assert colour_of(VobcMotion(0.2, 0.0, 0.0), told()).shown == "orange"


def test_the_dial_has_a_letter_at_each_limit_and_its_speed_filled() -> None:
    """At 80 km/h in 56 cells a cell is 1.43 km/h."""
    motion = VobcMotion(36.0 / 3.6, 50.0 / 3.6, 60.0 / 3.6)
    limits = VobcLimits(53.0 / 3.6, 57.0 / 3.6)

    drawn = dial(motion, limits, told(kind=TargetKind.END))

    assert drawn == "[T" + "#" * 24 + "." * 10 + "P.W..S.E" + "." * 13 + "] 80"
    assert dial(motion, None, None) == "[" + "#" * 25 + "." * 10 + "P......E" + "." * 13 + "] 80"
    assert dial(replace(motion, emergency_mps=81.0 / 3.6), limits, None).endswith("] 100")


def test_the_target_bar_empties_towards_the_target() -> None:
    distances_m = (6000.0, 1000.0, 300.0, 100.0, 30.0, 5.0, 0.0, -3.0)

    bars = [
        target_text(told(kind=TargetKind.RESTRICTION, target_mps=7.0, target_distance_m=each))
        for each in distances_m
    ]

    filled = [bar.count("#") for bar in bars]
    assert filled == sorted(filled, reverse=True)
    assert filled[:2] == [20, 20]
    assert filled[-2:] == [0, 0]
    assert "25.2 km/h in 300 m, restriction" in bars[2]
    assert target_text(told()) == "none"


def test_the_screen_shows_limits_target_and_why_protection_intervenes() -> None:
    display = shown(16.0, 15.0, 17.0)
    before = "\n".join(lines(display, MANUAL, 0))
    display.hear(VobcLimits(15.5, 16.5), 0)
    display.hear(told(Intervention.SERVICE_BRAKE, TargetKind.LINE_LIMIT, 10.0, 80.0), 0)

    text = "\n".join(lines(display, MANUAL, 0))

    assert "warning --" in before
    assert status_colour(display, 0) is StatusColour.RED
    for words in (
        *("red: protection brakes", "warning 55.8  service 59.4"),
        *("36.0 km/h in 80 m, line limit", "protection  service brake: rollback"),
    ):
        assert words in text
    assert status_colour(display, FRESH_NS + 1) is None


def test_the_cause_of_an_emergency_is_shown_without_the_frame_of_the_supervision() -> None:
    display = shown(0.0, 15.0, 17.0)
    display.hear(replace(MODE, cause=Cause.BUTTON), 0)

    assert "protection  emergency: button" in "\n".join(lines(display, MANUAL, 0))
