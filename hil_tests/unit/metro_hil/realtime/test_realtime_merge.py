"""Frames and truth arrive on different paths and are judged in the order of their instants."""

from hypothesis import given
from hypothesis import strategies as st

from metro_hil.realtime.merge import HOLD_NS, Merge

MS = 1_000_000


@given(st.lists(st.tuples(st.integers(0, 200), st.integers(0, 29)), max_size=60))
def test_items_within_the_hold_time_are_returned_complete_and_in_order(
    things: list[tuple[int, int]],
) -> None:
    """Each item is added up to 29 ms after its instant, and all items are taken in between."""
    merge: Merge[int] = Merge()
    arrivals = sorted(
        ((stamp_ms + delay_ms) * MS, stamp_ms * MS, number)
        for number, (stamp_ms, delay_ms) in enumerate(things)
    )
    out: list[tuple[int, int]] = []

    for now_ns, stamp_ns, number in arrivals:
        out += merge.due(now_ns)
        merge.add(stamp_ns, number)
    out += merge.rest()

    stamps = [stamp_ns for stamp_ns, _ in out]
    assert stamps == sorted(stamps)
    assert sorted(number for _, number in out) == list(range(len(things)))
    assert merge.late == 0


def test_no_item_is_returned_while_an_older_one_could_arrive() -> None:
    merge: Merge[str] = Merge()
    merge.add(0, "frame")

    assert list(merge.due(HOLD_NS - 1)) == []
    assert list(merge.due(HOLD_NS)) == [(0, "frame")]


def test_late_items_are_counted_and_never_turn_time_back() -> None:
    merge: Merge[str] = Merge()
    merge.add(50 * MS, "young")
    assert list(merge.due(50 * MS + HOLD_NS)) == [(50 * MS, "young")]

    merge.add(10 * MS, "old")

    assert list(merge.rest()) == [(50 * MS, "old")]
    assert merge.late == 1
