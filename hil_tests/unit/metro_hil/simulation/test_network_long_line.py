"""What a train hears and who is disturbed depend on its area, not on how long the line is."""

from collections.abc import Sequence
from typing import Any

import pytest

from metro_hil.simulation import routes
from metro_hil.simulation.long_line import LongLine, play
from metro_hil.simulation.node import QueuedMessage

EACH = 5


def few_and_many() -> tuple[LongLine, LongLine]:
    return play(5, EACH, seconds=1.0), play(9, EACH, seconds=1.0)


def test_a_line_of_more_areas_gives_no_train_more_to_hear() -> None:
    few, many = few_and_many()

    assert many.heard_per_s <= 1.15 * few.heard_per_s
    for line in (few, many):
        assert line.held_s < 2.0
        assert line.oldest_ms < 300.0
        assert line.followed_ms <= 450.0
        assert (line.other_terms, line.emergencies) == (0, 0)


def test_trains_that_listened_everywhere_would_hear_all_of_the_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def to_all(targets: Sequence[int], message: Any, topic: int | None) -> QueuedMessage:
        return QueuedMessage(targets, message)

    monkeypatch.setattr(routes, "QueuedMessage", to_all)
    few, many = few_and_many()

    assert many.heard_per_s > 1.5 * few.heard_per_s
