"""The virtual serial line takes the transmission time of a real one and counts every loss."""

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.tag_reader.inproc_line import inproc_line

MS = 1_000_000


def byte_end_ns(count: int, baud: int = 115_200) -> Fraction:
    return Fraction(count * 10 * 10**9, baud)


def test_a_byte_is_received_at_the_end_of_its_stop_bit() -> None:
    reader, controller = inproc_line()
    reader.send(5 * MS, b"ab")

    first_ns, second_ns = (5 * MS + int(byte_end_ns(count)) for count in (1, 2))

    assert list(controller.receive(first_ns - 1)) == []
    assert [chunk.data for chunk in controller.receive(first_ns)] == [b"a"]
    assert [chunk.data for chunk in controller.receive(second_ns - 1)] == []
    (chunk,) = controller.receive(second_ns)
    assert chunk == (second_ns, b"b")


def test_a_second_telegram_waits_for_the_first() -> None:
    reader, controller = inproc_line()
    reader.send(0, b"x" * 100)
    reader.send(1, b"y" * 100)

    chunks = controller.receive(10**9)

    assert [chunk.data for chunk in chunks] == [b"x" * 100, b"y" * 100]
    assert chunks[1].stamp_ns == pytest.approx(float(byte_end_ns(200)), abs=2)


def test_both_directions_are_independent() -> None:
    reader, controller = inproc_line()
    reader.send(0, b"down")
    controller.send(0, b"up")

    assert [chunk.data for chunk in controller.receive(MS)] == [b"down"]
    assert [chunk.data for chunk in reader.receive(MS)] == [b"up"]


@given(
    st.lists(st.tuples(st.integers(0, 20 * MS), st.binary(min_size=1, max_size=40)), max_size=8),
    st.lists(st.integers(0, 60 * MS), max_size=12),
)
def test_arrival_times_do_not_depend_on_the_instants_of_reception(
    sends: list[tuple[int, bytes]], looks: list[int]
) -> None:
    """The oracle transmits byte by byte with exact fractions."""
    reader, controller = inproc_line()
    for at_ns, data in sorted(sends):
        reader.send(at_ns, data)
    played: list[tuple[Fraction, int]] = []
    free_ns = Fraction(0)
    for at_ns, data in sorted(sends):
        start_ns = max(Fraction(at_ns), free_ns)
        played += [(start_ns + byte_end_ns(i + 1), byte) for i, byte in enumerate(data)]
        free_ns = start_ns + byte_end_ns(len(data))

    heard = b""
    for now_ns in sorted(looks):
        for chunk in controller.receive(now_ns):
            assert chunk.stamp_ns <= now_ns
            heard += chunk.data
        # The port rounds ends to whole nanoseconds, so it may be ahead by the rounding.
        assert len(heard) >= sum(end_ns <= now_ns for end_ns, _ in played)
        assert len(heard) <= sum(end_ns <= now_ns + len(sends) + 1 for end_ns, _ in played)

    assert heard == bytes(byte for _, byte in played)[: len(heard)]


def test_an_unread_line_is_bounded_and_counts_dropped_bytes() -> None:
    reader, controller = inproc_line(capacity_bytes=100)
    for _ in range(5):
        reader.send(0, b"z" * 30)

    assert reader.counters.sent == 90
    assert reader.counters.dropped_out == 60
    assert sum(len(chunk.data) for chunk in controller.receive(10**9)) == 90
    reader.send(10**9, b"z" * 100)
    assert reader.counters.sent == 190
    assert controller.counters.received == 90


def test_a_closed_end_neither_sends_nor_receives() -> None:
    reader, controller = inproc_line()
    reader.send(0, b"abc")
    controller.close()

    assert list(controller.receive(10**9)) == []
    controller.send(10**9, b"up")
    assert list(reader.receive(2 * 10**9)) == []
    assert controller.counters.dropped_out == 2


@pytest.mark.parametrize("baud", [9600, 115_200, 1_000_000])
def test_the_baud_rate_sets_the_time(baud: int) -> None:
    reader, controller = inproc_line(baud=baud)
    reader.send(0, bytes(50))

    (chunk,) = controller.receive(10**10)

    assert chunk.stamp_ns == int(byte_end_ns(50, baud))
