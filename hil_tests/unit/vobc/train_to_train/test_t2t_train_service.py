"""Supervision takes a train out of service and back by command, and the train obeys."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from firmware_py.storage.checked_store import CheckedStore
from firmware_py.trackdb.areas import Area, AreaMap
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import AreaMemory, OwnTrain, Stepped, T2tConfig, TrainMemory
from zenoh_config.t2t import (
    BROADCAST,
    NO_TRAIN,
    SUPERVISION,
    Heartbeat,
    LineOrder,
    OrderKind,
    Phase,
    T2tMessage,
    TrainReport,
)

MS = 1_000_000
OWN, MASTER = 5, 9
AREAS = (Area(1, 0.0, 2000.0), Area(2, 2000.0, 4000.0), Area(3, 4000.0, 6000.0))
OUT = TrainMemory(6, (AreaMemory(1, seen_term=3),), out_of_service=True)

_SEQUENCE: Iterator[int] = iter(range(1, 10**9))


class Ride:
    """A train just before the border of two areas."""

    def __init__(self, memory: TrainMemory | None = None) -> None:
        kept = memory or TrainMemory()
        line = AreaMap("test", AREAS)
        self.core = TrainCore(T2tConfig(), line, address=OWN, memory=kept, start_ns=0)

    def step(self, at_ms: int, *heard: T2tMessage, out_of_service: bool = False) -> Stepped:
        place = (True, 1900.0, 1900.0, 1820.0, 1820.0, 2.0, False, 1900.0, 1900.0, 16)
        return self.core.step(at_ms * MS, heard, OwnTrain(*place, out_of_service))

    def says_out(self, at_ms: int, *heard: T2tMessage, **told: Any) -> bool:
        """Whether the train reports itself out of service; all areas must get the same answer."""
        out = self.step(at_ms, *heard, **told).out
        (said,) = {each.out_of_service for each in out if isinstance(each, TrainReport)}
        return said


def order(kind: OrderKind, train: int = OWN, *, area: int = 1) -> LineOrder:
    return LineOrder(SUPERVISION, BROADCAST, area, 0, 1, next(_SEQUENCE), 77, kind, train)


def beat() -> Heartbeat:
    first = (MASTER, BROADCAST, 1, 4, 1, next(_SEQUENCE), 77)
    return Heartbeat(*first, Phase.ISSUING, NO_TRAIN, 1)


def test_a_train_is_out_of_service_by_command_until_another_command() -> None:
    ride = Ride()

    assert not ride.says_out(0)
    assert ride.says_out(100, order(OrderKind.OUT_OF_SERVICE))
    assert ride.says_out(200, order(OrderKind.STOP))
    assert ride.says_out(300)
    assert not ride.says_out(400, order(OrderKind.IN_SERVICE))
    assert not ride.says_out(500, order(OrderKind.GO))


def test_no_command_brings_a_train_into_service_that_is_out_by_itself() -> None:
    ride = Ride()

    assert ride.says_out(0, order(OrderKind.IN_SERVICE), out_of_service=True)


def test_orders_to_other_trains_change_nothing() -> None:
    ride = Ride()
    assert not ride.says_out(0, order(OrderKind.OUT_OF_SERVICE, 6))
    ride.step(50, order(OrderKind.OUT_OF_SERVICE))

    assert ride.says_out(100, order(OrderKind.IN_SERVICE, 6))


def test_a_command_counts_even_from_an_area_that_does_not_concern_the_train() -> None:
    ride = Ride()

    assert ride.says_out(0, order(OrderKind.OUT_OF_SERVICE, area=3))
    assert ride.core.refusals == {"area of no concern": 1}


def test_a_new_command_is_stored_in_the_step_that_obeys_it() -> None:
    ride = Ride()
    ride.step(0)

    def stored(at_ms: int, kind: OrderKind) -> bool | None:
        memory = ride.step(at_ms, order(kind)).memory
        return None if memory is None else memory.out_of_service

    assert stored(100, OrderKind.IN_SERVICE) is None
    assert stored(200, OrderKind.OUT_OF_SERVICE) is True
    assert stored(300, OrderKind.OUT_OF_SERVICE) is None
    assert stored(400, OrderKind.STOP) is None
    assert stored(500, OrderKind.IN_SERVICE) is False


@pytest.mark.parametrize("kept", [OUT, TrainMemory(6)])
def test_a_command_holds_over_the_next_start(kept: TrainMemory) -> None:
    ride = Ride(kept)

    assert ride.says_out(0) is kept.out_of_service
    assert not ride.says_out(100, order(OrderKind.IN_SERVICE))


def test_storing_a_term_does_not_change_the_command() -> None:
    ride = Ride(OUT)

    memory = ride.step(0, beat()).memory

    assert memory is not None
    assert (memory.of_area(1).seen_term, memory.out_of_service) == (4, True)


def test_a_memory_of_the_former_format_is_readable(tmp_path: Path) -> None:
    store = CheckedStore(tmp_path / "line.json", TrainMemory)
    store.put(OUT)
    assert CheckedStore(tmp_path / "line.json", TrainMemory).value == OUT
    older = CheckedStore(tmp_path / "older.json", dict)
    older.put({"boot": 6, "areas": []})

    assert CheckedStore(tmp_path / "older.json", TrainMemory).value == TrainMemory(6)
