"""The real codec under the simulated network: messages travel as the bytes of the radio."""

from collections import Counter
from typing import Final

from zenoh_config.codec import AnyMessage, pack, unpack
from zenoh_config.messages import Refused, RefusedReason
from zenoh_config.t2t import T2tMessage

OPENED_MAX: Final = 512


class RealCodec:
    """Encodes and decodes messages; counts rejected ones by reason."""

    def __init__(self) -> None:
        self.refusals: Counter[RefusedReason] = Counter()
        self._opened: dict[bytes, AnyMessage | Refused] = {}
        """Decoded messages of the newest payloads. All receivers of one message get the same
        bytes."""

    def seal(self, message: T2tMessage) -> bytes:
        return pack(message)

    def open(self, payload: bytes) -> T2tMessage | None:
        message = self._opened.get(payload)
        if message is None:
            message = self._opened[payload] = unpack(payload)
            if len(self._opened) > OPENED_MAX:
                del self._opened[next(iter(self._opened))]
        if isinstance(message, Refused):
            self.refusals[message.reason] += 1
            return None
        assert isinstance(message, T2tMessage)
        return message
