"""The judgement of a line run: true positions, authorities at the time of their issue, and
terms."""

from dataclasses import replace

import pytest

from can_dbc.vobc import Cause, Supervision
from firmware_py.ports import RadioMessage
from firmware_py.trackdb import load_line
from firmware_py.trackdb.areas import load_areas
from hil_tests.unit.plant_emulator.wayside.test_line_centre import STATUS
from hil_tests.unit.vobc.train_to_train.test_t2t_envelope import REPORT
from metro_hil.line.exercise.event_log import LineEvents
from metro_hil.line.exercise.results import result_of
from metro_hil.line.exercise.verdict import complaints, emergency_words
from plant_emulator.wayside.detection import Place, packed, subscription
from zenoh_config import keys
from zenoh_config.codec import pack
from zenoh_config.t2t import BROADCAST, AreaAuthority, Heartbeat, Phase, T2tMessage
from zenoh_config.t2t_keys import key_of

MS = 1_000_000
BEAT = Heartbeat(1, BROADCAST, 1, 7, 1, 1, 0, Phase.ISSUING, 2, 1)
GIVEN = AreaAuthority(1, 2, 1, 7, 1, 2, 0, 1, 0, 900.0, 80.0, 1, 2, ())


class Told:
    def __init__(self) -> None:
        self.said: list[str] = []
        self.story = LineEvents(
            load_line("loop"), load_areas("loop"), lambda _, words: self.said.append(words)
        )
        self.story.stands(1, Place(1080.0, 1000.0, 16))
        self.story.stands(2, Place(180.0, 100.0, 16))

    def on_message(self, message: T2tMessage, at_ms: int) -> None:
        self.story.on_message([RadioMessage(at_ms * MS, key_of("loop", message), pack(message))])


def test_the_gap_reaches_from_an_authority_to_the_true_rear_ahead() -> None:
    told = Told()
    told.on_message(BEAT, 0)
    told.on_message(GIVEN, 50)

    told.story.stands(1, Place(1080.5, 1000.5, 16))

    assert told.story.train(2).least_gap_m == 100.5
    told.story.train(1).given = dict(told.story.train(2).given)
    assert complaints(told.story, 2, behind_rear_m=7.0) == []
    assert complaints(told.story, 2, behind_rear_m=101.0) == [
        "train 2: authority ends only 100.50 m behind the next"
    ]


def test_a_delayed_position_does_not_judge_a_later_authority() -> None:
    """The train ahead had moved on by 10 m in 500 ms when the authority was sent."""
    told = Told()
    told.story.stands(1, Place(1080.0, 1000.0, 16, 100 * MS))
    told.on_message(replace(GIVEN, end_m=1000.5, stamp_ns=350 * MS), 360)

    for late_ms, rear_m in ((200, 1002.0), (300, 1004.0)):
        told.story.stands(1, Place(rear_m + 80.0, rear_m, 16, late_ms * MS))
        told.story.stands(2, Place(180.0, 100.0, 16, 500 * MS))
        assert told.story.train(2).least_gap_m == float("inf")
    told.story.stands(1, Place(1086.0, 1006.0, 16, 400 * MS))

    # The train was half way between these two positions when the authority was sent.
    assert told.story.train(2).least_gap_m == 1005.0 - 1000.5
    told.story.stands(1, Place(1084.5, 1004.5, 16, 500 * MS))
    assert told.story.train(2).least_gap_m == 1004.5 - 1000.5


def test_late_positions_are_compared_with_earlier_authorities() -> None:
    """Positions are 400 ms late, while a new authority comes every 100 ms; the third reaches too
    far."""
    told = Told()
    for n in range(12):
        end_m = 990.0 if n != 3 else 1002.0
        told.on_message(replace(GIVEN, end_m=end_m, sequence=3 + n, stamp_ns=n * 100 * MS), n * 100)
        told.story.stands(1, Place(1080.0, 1000.0, 16, max(0, n - 4) * 100 * MS))

    assert told.story.train(2).least_gap_m == -2.0


def test_a_masters_own_authority_counts_from_its_report() -> None:
    told = Told()
    told.on_message(replace(BEAT, source=2), 0)
    held = replace(REPORT, source=2, stamp_ns=350 * MS, front_min_m=180.0, front_max_m=181.0)
    held = replace(held, easy_m=181.0, latent_m=1000.5, held_term=7, held_end_m=1000.5, area=1)
    told.on_message(held, 360)
    told.story.stands(1, Place(1084.0, 1004.0, 16, 300 * MS))
    assert told.story.train(2).least_gap_m == float("inf")

    told.story.stands(1, Place(1085.0, 1005.0, 16, 350 * MS))
    assert told.story.train(2).least_gap_m == 4.5


def test_an_authority_reaches_into_the_next_area_only_with_that_areas_authority() -> None:
    told = Told()
    told.story.stands(1, Place(3080.0, 3000.0, 16))
    told.on_message(replace(GIVEN, end_m=2800.0), 50)
    told.story.stands(1, Place(3080.5, 3000.5, 16))
    assert told.story.train(2).least_gap_m == 200.5

    told.on_message(replace(GIVEN, area=2, end_m=2950.0, rear_m=0.0), 60)
    told.story.stands(1, Place(3081.0, 3001.0, 16))

    assert told.story.train(2).least_gap_m == 51.0


def test_a_new_term_is_reported_with_the_silence_before_it_and_the_time_to_serve_all() -> None:
    told = Told()
    told.on_message(BEAT, 0)
    told.on_message(GIVEN, 50)
    told.on_message(replace(BEAT, stamp_ns=60 * MS, sequence=3), 60)

    told.on_message(replace(BEAT, source=3, term=9), 360)
    told.on_message(replace(GIVEN, source=3, term=9, echo_ns=380 * MS), 400)

    assert told.said == [
        "area 1: train 1 commands, term 7",
        "area 1: train 3 commands, term 9; train 1 sent its last heartbeat 0.30 s before",
        "area 1: every train has an authority of term 9, 0.34 s after the last heartbeat before it",
    ]
    assert told.story.train(2).oldest_ms == 400.0
    assert told.story.train(2).latencies_ms == [50.0, 20.0]


def test_every_emergency_brake_is_reported_and_the_verdict_counts_unexplained_ones() -> None:
    told = Told()

    def brakes(cause: Cause, at_ms: int, train: int = 2) -> None:
        told.story.tells(train, Supervision.NOMINAL, Cause.NONE, at_ms * MS)
        told.story.tells(train, Supervision.EMERGENCY, cause, (at_ms + 5) * MS)

    brakes(Cause.BRAKE_UNIT, 10)
    told.on_message(GIVEN, 50)
    brakes(Cause.OVERSPEED, 60)
    brakes(Cause.AUTHORITY_OLD, 2000)
    told.story.excused.add("authority old")
    brakes(Cause.AUTHORITY_OLD, 3000)
    told.story.strikes(2)
    brakes(Cause.BUTTON, 4000)

    causes = ["brake unit", "overspeed", "authority old", "authority old", "button"]
    assert told.said == [f"train 2 applies its emergency brake: {cause}" for cause in causes]
    assert emergency_words(result_of(2, told.story.train(2))) == ", ".join([*causes, "struck"])
    told.story.train(1).given = dict(told.story.train(2).given)
    assert complaints(told.story, 2, behind_rear_m=7.0) == [
        "train 2: emergency brake although it was commanded: overspeed",
        "train 2: emergency brake while it had no fresh authority: authority old",
    ]


def test_supervision_states_are_taken_from_the_bus_and_not_from_the_radio() -> None:
    """The radio repeats it late once radios work again."""
    told = Told()
    late = replace(STATUS, train=2, supervision=Supervision.EMERGENCY, cause=Cause.BUTTON)
    told.story.on_message([RadioMessage(50 * MS, keys.status("loop", 2), pack(late))])

    assert told.said == []
    assert told.story.refused == 0


def test_overlapping_trains_are_a_collision_whatever_the_authorities() -> None:
    told = Told()

    told.story.stands(2, Place(1000.5, 920.5, 16))

    assert "train 2 stands in train 1" in complaints(told.story, 2, behind_rear_m=7.0)


def test_a_stop_is_reported_with_its_distance_and_a_passage_is_not() -> None:
    told = Told()
    for front_m in (795.0, 799.0, 800.3, 800.3, 1599.0, 1610.0):
        told.story.stands(2, Place(front_m, front_m - 80.0, 16))

    (stop,) = told.story.train(2).stops
    assert stop.station == "S2"
    assert abs(stop.error_m - 0.3) < 1e-9


def test_the_speed_follows_the_true_positions_even_with_a_silent_controller() -> None:
    told = Told()
    told.on_message(
        replace(REPORT, source=2, speed_mps=12.4, front_min_m=180.0, front_max_m=181.0), 0
    )
    told.story.stands(2, Place(180.5, 100.5, 16, 100 * MS))

    told.story.stands(2, Place(181.5, 101.5, 16, 300 * MS))
    assert told.story.train(2).speed_mps == 5.0

    told.story.stands(2, Place(181.5, 101.5, 16, 500 * MS))
    assert told.story.train(2).speed_mps == 0.0


def test_a_message_under_a_foreign_key_is_ignored() -> None:
    told = Told()
    told.story.on_message([RadioMessage(0, key_of("loop", replace(BEAT, source=4)), pack(BEAT))])

    assert told.said == []
    assert told.story.refused == 1


@pytest.mark.parametrize(
    ("train", "payload"), [("x", packed(Place(9.0, 1.0, 16))), ("3", b"?"), ("", b"")]
)
def test_an_invalid_position_does_not_end_a_run(train: str, payload: bytes) -> None:
    told = Told()
    told.story.on_message(
        [RadioMessage(0, subscription("loop").removesuffix("*") + train, payload)]
    )

    assert set(told.story.trains) == {1, 2}
    assert told.story.refused == 1
