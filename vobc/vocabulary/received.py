"""A received value with the instant of its reception. mypyc cannot compile a generic dataclass."""

from dataclasses import dataclass
from typing import Final, Generic, TypeVar

T = TypeVar("T")

S_PER_NS: Final = 1e-9


@dataclass(frozen=True, slots=True)
class Received(Generic[T]):
    """The newest value of one source, together with the instant that its age counts from."""

    value: T
    received_at_ns: int
    """By the train's own clock. A sample of the odometer counts from its sensor's stamp, a radio
    message from the report that it answers, everything else from its last bit."""

    def age_s(self, now_ns: int) -> float:
        return (now_ns - self.received_at_ns) * S_PER_NS
