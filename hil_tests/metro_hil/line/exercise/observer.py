"""Whether what watches a line keeps up with it: only then do its judgements say anything. Pure.

A message waits where the observer is too slow: in the inbox of its session, and before that in the
buffers of the network. So the instant at which it is taken says nothing. The message itself says
when it was sent, by the clock that all programs of one machine share.
"""

from collections.abc import Mapping
from typing import Final

from metro_hil.line.exercise.event_log import LineEvents

LAG_NS: Final = 500_000_000
"""Greatest age of the newest message when something is judged."""
NS_PER_S: Final = 1e9


class Observer:
    """Let it look whenever something is judged; `doubts` says why a judgement proves nothing."""

    def __init__(self, story: LineEvents, trains: int) -> None:
        """Args:
        trains: how many there are, with the numbers from 1 on.
        """
        self._story = story
        self._numbers = range(1, trains + 1)
        self._expected_from_ns = 0
        self._late = 0
        self._worst_ns = 0
        self._worst_words = ""
        self._end_words = ""

    def expects_from(self, now_ns: int) -> None:
        """Messages were not expected before, as programs were starting or the radio was away."""
        self._expected_from_ns = now_ns

    def looks(self, now_ns: int) -> None:
        """Something is judged now: by the newest message of all, and the newest place of each."""
        self.looks_at_newest(now_ns)
        for number, stamp_ns in self._places():
            self._judge(now_ns, stamp_ns, f"the newest place of train {number}")

    def looks_at_newest(self, now_ns: int) -> None:
        """Something is judged by the newest message alone, as not all trains are there yet."""
        self._judge(now_ns, self._story.newest_ns, "the newest message")

    def ends(self, end_ns: int) -> None:
        """The run ended at `end_ns`, and what came for a while after that was taken, too."""
        late = [number for number, stamp_ns in self._places() if stamp_ns < end_ns]
        if late:
            trains = ", ".join([str(number) for number in late])
            self._end_words = (
                f"messages were still on their way to the observer at the end (trains {trains})"
            )

    def has_all_until(self, at_ns: int) -> bool:
        """Whether all that was sent before an instant was taken, as each train has sent since.

        One session brings its messages in the order in which they were sent.
        """
        return all(stamp_ns >= at_ns for _, stamp_ns in self._places())

    def doubts(self, dropped: Mapping[str, int]) -> list[str]:
        """Sentences; none when every judgement was made by messages that were young enough.

        Args:
            dropped: how many messages an inbox had no room for, by the name of the inbox.
        """
        said = []
        if self._late:
            said.append(
                f"the observer lagged: {self._worst_words} when the run was judged by it; at most "
                f"{LAG_NS / NS_PER_S:g} s are allowed ({self._late} times over)"
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
