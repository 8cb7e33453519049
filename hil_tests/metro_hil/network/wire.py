"""The real codec under the simulated network: messages travel as the bytes of the radio."""

from collections import Counter

from zenoh_config.codec import pack, unpack
from zenoh_config.messages import Refused, RefusedReason
from zenoh_config.t2t import T2tMessage


class RealCodec:
    """Counts what it refuses by reason."""

    def __init__(self) -> None:
        self.refusals: Counter[RefusedReason] = Counter()

    def seal(self, message: T2tMessage) -> bytes:
        return pack(message)

    def open(self, payload: bytes) -> T2tMessage | None:
        message = unpack(payload)
        if isinstance(message, Refused):
            self.refusals[message.reason] += 1
            return None
        assert isinstance(message, T2tMessage)
        return message
