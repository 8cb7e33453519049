"""When a controller reports that it receives nothing on the radio of its line."""

from can_dbc.vobc import EventKind
from vobc.process.line_silence import SILENT_S, LineSilence

S = 1_000_000_000
LONG_NS = round(SILENT_S * S)
ENDPOINT = "tcp/127.0.0.1:7448"
WORDS = (
    f"nothing is received on the line's radio at {ENDPOINT}: is its wayside there, and of this "
    "line?"
)


def test_a_line_that_is_silent_from_the_start_is_reported_once() -> None:
    silence = LineSilence(ENDPOINT)

    assert silence.look(7 * S, 0) is None
    assert silence.look(7 * S + LONG_NS - 1, 0) is None
    assert silence.words == ""
    told = silence.look(7 * S + LONG_NS, 0)
    assert told is not None
    assert (told.kind, told.words, told.number) == (EventKind.INPUT_LOST, WORDS, 0)
    assert silence.words == WORDS
    assert silence.look(9 * LONG_NS, 0) is None


def test_the_first_message_ends_the_report_and_the_next_silence_is_reported_again() -> None:
    silence = LineSilence(ENDPOINT)
    silence.look(0, 0)
    silence.look(LONG_NS, 0)

    back = silence.look(LONG_NS + S, 1)
    assert back is not None
    assert (back.kind, back.number) == (EventKind.INPUT_BACK, 0)
    assert silence.words == ""
    assert silence.look(LONG_NS + S + LONG_NS - 1, 1) is None
    assert silence.look(LONG_NS + S + LONG_NS, 1) is not None


def test_while_messages_arrive_no_silence_is_reported() -> None:
    silence = LineSilence(ENDPOINT)

    assert [silence.look(second * S, second) for second in range(60)] == [None] * 60


def test_slow_arbiters_are_reported_once_and_once_when_they_are_quick_again() -> None:
    silence = LineSilence(ENDPOINT)
    assert silence.look_at_answers(0.0, 140) is None
    assert silence.look_at_answers(140.0, 140) is None

    slow = silence.look_at_answers(310.4, 140)
    assert slow is not None
    assert slow.words == silence.slow == "arbiters answer after 310 ms, need < 140"
    assert silence.look_at_answers(500.0, 140) is None
    assert silence.look_at_answers(130.0, 140) is None

    assert silence.look_at_answers(120.0, 140) is not None
    assert silence.slow == ""
    assert silence.look_at_answers(130.0, 140) is None
