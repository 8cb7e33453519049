"""A received value with the instant of its reception."""

from typing import Final, Generic, TypeVar

T = TypeVar("T")

S_PER_NS: Final = 1e-9


class Received(Generic[T]):
    """The newest value of one source, together with the instant that its age counts from.

    It is no dataclass because mypyc cannot compile a generic one.
    """

    def __init__(self, value: T, received_at_ns: int) -> None:
        """Args:
        received_at_ns: by the train's own clock. A sample of the odometer counts from its sensor's
            stamp, a radio message from the report that it answers, everything else from its last
            bit.
        """
        self.value: Final = value
        self.received_at_ns: Final = received_at_ns

    def age_s(self, now_ns: int) -> float:
        return (now_ns - self.received_at_ns) * S_PER_NS
