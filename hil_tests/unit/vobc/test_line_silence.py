"""When a controller says that nobody is heard on the radio of its line."""

from can_dbc.vobc import EventKind
from vobc.process.line_silence import SILENT_S, LineSilence

S = 1_000_000_000
LONG_NS = round(SILENT_S * S)
ENDPOINT = "tcp/127.0.0.1:7448"
WORDS = (
    f"nothing is heard on the line's radio at {ENDPOINT}: is its wayside there, and of this line?"
)


def test_a_line_that_is_not_heard_from_the_start_on_is_told_once() -> None:
    silence = LineSilence(ENDPOINT)

    assert silence.look(7 * S, 0) is None
    assert silence.look(7 * S + LONG_NS - 1, 0) is None
    assert silence.words == ""
    told = silence.look(7 * S + LONG_NS, 0)
    assert told is not None
    assert (told.kind, told.words, told.number) == (EventKind.INPUT_LOST, WORDS, 0)
    assert silence.words == WORDS
    assert silence.look(9 * LONG_NS, 0) is None


def test_the_first_word_that_is_heard_ends_it_and_the_next_silence_is_told_again() -> None:
    silence = LineSilence(ENDPOINT)
    silence.look(0, 0)
    silence.look(LONG_NS, 0)

    back = silence.look(LONG_NS + S, 1)
    assert back is not None
    assert (back.kind, back.number) == (EventKind.INPUT_BACK, 0)
    assert silence.words == ""
    assert silence.look(LONG_NS + S + LONG_NS - 1, 1) is None
    assert silence.look(LONG_NS + S + LONG_NS, 1) is not None


def test_while_somebody_is_heard_there_is_nothing_to_tell() -> None:
    silence = LineSilence(ENDPOINT)

    assert [silence.look(second * S, second) for second in range(60)] == [None] * 60
