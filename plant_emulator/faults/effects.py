"""What faults do to the train: effects that act for a while, and knobs that several may turn."""

from collections.abc import Callable, Sequence
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

V = TypeVar("V")


class Effect(Protocol):
    """What one fault does. It is told of its begin, then of every step of the plant, of its end."""

    def begin(self, now_ns: int) -> None: ...

    def end(self, now_ns: int) -> None: ...

    def step(self, now_ns: int) -> bool:
        """Before the train moves on from `now_ns`; after the end only as long as it says true."""
        ...


@runtime_checkable
class Counting(Protocol):
    """An effect that counts by itself what it changed."""

    touched: int


class SharedSetting(Generic[V]):
    """One thing of the train that is set by all faults together that act on it."""

    def __init__(self, turn: Callable[[Sequence[V]], None]) -> None:
        """Args:
        turn: sets the thing to what the faults make of it that act now, told in the order of the
            scenario; when there are none, to what it is by itself.
        """
        self._turn = turn
        self._values: dict[int, V] = {}

    def set(self, index: int, value: V) -> None:
        """What the fault of that index wants from now on."""
        self._values[index] = value
        self._apply()

    def clear(self, index: int) -> None:
        if self._values.pop(index, None) is not None:
            self._apply()

    def _apply(self) -> None:
        self._turn([value for _, value in sorted(self._values.items(), key=_index)])


class SettingFault:
    """Knobs that stay turned as long as the fault lasts."""

    def __init__(self, index: int, *settings: tuple[SharedSetting[Any], Any]) -> None:
        self._index, self._settings = index, settings

    def begin(self, now_ns: int) -> None:
        for knob, value in self._settings:
            knob.set(self._index, value)

    def end(self, now_ns: int) -> None:
        for knob, _ in self._settings:
            knob.clear(self._index)

    def step(self, now_ns: int) -> bool:
        return False


def _index(item: tuple[int, object]) -> int:
    return item[0]
