"""Effects of faults on the train, and settings that several faults can share."""

from collections.abc import Callable, Sequence
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

V = TypeVar("V")


class Effect(Protocol):
    """The effect of one fault. `begin`, then `step` at every plant step, then `end` are called."""

    def begin(self, now_ns: int) -> None: ...

    def end(self, now_ns: int) -> None: ...

    def step(self, now_ns: int) -> bool:
        """Act before the train moves on from `now_ns`.

        After the end, it is called only while it returns True.
        """
        ...


@runtime_checkable
class Counting(Protocol):
    """An effect that itself counts what it changed."""

    touched: int


class SharedSetting(Generic[V]):
    """One setting of the train that all active faults determine together."""

    def __init__(self, turn: Callable[[Sequence[V]], None]) -> None:
        """Args:
        turn: applies the values of all active faults, in the order of the scenario; an empty
            sequence restores the normal value.
        """
        self._turn = turn
        self._values: dict[int, V] = {}

    def set(self, index: int, value: V) -> None:
        """Set the value that the fault of this index demands."""
        self._values[index] = value
        self._apply()

    def clear(self, index: int) -> None:
        if self._values.pop(index, None) is not None:
            self._apply()

    def _apply(self) -> None:
        self._turn([value for _, value in sorted(self._values.items(), key=_index)])


class SettingFault:
    """A fault that sets values for as long as it is active."""

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
