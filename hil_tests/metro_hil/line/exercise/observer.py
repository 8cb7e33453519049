"""Judges whether the observer of a line keeps up with it, as only then its verdict counts.

Pure.

If the observer is too slow, messages wait in the inbox of its session and in network buffers. Their
instant of arrival says nothing then. But each message holds its sending instant, by the clock that
all programs of one machine share.
"""

from collections.abc import Mapping
from typing import Final

from metro_hil.line.exercise.event_log import LineEvents

LAG_NS: Final = 500_000_000
"""Greatest age of the newest message when a verdict is made."""
NS_PER_S: Final = 1e9


class Observer:
    """Checks the age of messages at every judgement; `doubts` says why the run proves nothing."""

    def __init__(self, story: LineEvents, trains: int) -> None:
        """Observe a line.

        Args:
            trains: number of trains, which are numbered from 1.
        """
        self._story = story
        self._numbers = range(1, trains + 1)
        self._expected_from_ns = 0
        self._late = 0
        self._worst_ns = 0
        self._worst_words = ""
        self._end_words = ""

    def expects_from(self, now_ns: int) -> None:
        """Expect no messages before this instant: programs were starting or the radio was away."""
        self._expected_from_ns = now_ns

    def looks(self, now_ns: int) -> None:
        """Check the newest message and the newest position of each train for a judgement now."""
        self.looks_at_newest(now_ns)
        for number, stamp_ns in self._places():
            self._judge(now_ns, stamp_ns, f"the newest place of train {number}")

    def looks_at_newest(self, now_ns: int) -> None:
        """Check the newest message alone, while some trains have not started yet."""
        self._judge(now_ns, self._story.newest_ns, "the newest message")

    def ends(self, end_ns: int) -> None:
        """Check that every message sent before `end_ns` was received."""
        late = [number for number, stamp_ns in self._places() if stamp_ns < end_ns]
        if late:
            trains = ", ".join([str(number) for number in late])
            self._end_words = f"messages had not reached the observer at the end (trains {trains})"

    def has_all_until(self, at_ns: int) -> bool:
        """Tell whether every train has sent since this instant; then all earlier messages arrived.

        One session delivers its messages in the order of their sending.
        """
        return all(stamp_ns >= at_ns for _, stamp_ns in self._places())

    def doubts(self, dropped: Mapping[str, int]) -> list[str]:
        """Return the reasons why the run proves nothing; none if all messages were fresh enough.

        Args:
            dropped: number of messages for which an inbox had no room, by its name.
        """
        said = []
        if self._late:
            said.append(
                f"the observer lagged: {self._worst_words} when the run was judged; at most "
                f"{LAG_NS / NS_PER_S:g} s are allowed (exceeded {self._late} times)"
            )
        said += [f"{name} lost {count} messages" for name, count in dropped.items() if count]
        return [*said, self._end_words] if self._end_words else said

    def _places(self) -> list[tuple[int, int]]:
        trains = [(number, self._story.train(number)) for number in self._numbers]
        return [(n, 0 if each.place is None else each.place.stamp_ns) for n, each in trains]

    def _judge(self, now_ns: int, stamp_ns: int, what: str) -> None:
        age_ns = now_ns - max(stamp_ns, self._expected_from_ns)
        if age_ns <= LAG_NS:
            return
        self._late += 1
        if age_ns > self._worst_ns:
            self._worst_ns = age_ns
            self._worst_words = f"{what} was {age_ns / NS_PER_S:.2f} s old"
