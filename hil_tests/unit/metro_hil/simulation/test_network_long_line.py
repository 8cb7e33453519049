"""A train's received messages and disturbances depend on its area and not on the length of the
line."""

from collections.abc import Sequence
from typing import Any

import pytest

from metro_hil.simulation import routes
from metro_hil.simulation.long_line import play
from metro_hil.simulation.node import QueuedMessage


def test_more_areas_give_no_train_more_messages() -> None:
    few, many = (play(areas, 5, seconds=1.0) for areas in (5, 9))

    assert many.heard_per_s <= 1.15 * few.heard_per_s
    for line in (few, many):
        assert line.held_s < 2.0
        assert line.oldest_ms < 300.0
        assert line.followed_ms <= 450.0
        assert (line.other_terms, line.emergencies) == (0, 0)


def test_trains_that_listen_everywhere_would_receive_the_whole_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def to_all(targets: Sequence[int], message: Any, topic: int | None) -> QueuedMessage:
        return QueuedMessage(targets, message)

    monkeypatch.setattr(routes, "QueuedMessage", to_all)
    few, many = (play(areas, 2, seconds=1.0) for areas in (5, 9))

    assert many.heard_per_s > 1.5 * few.heard_per_s
