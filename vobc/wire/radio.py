"""The train on the radio: position reports out, movement authorities in."""

from collections.abc import Iterable
from typing import Final

from firmware_py.ports import RadioMessage
from vobc.vocabulary import (
    NEVER_S,
    Authority,
    CycleOutput,
)
from zenoh_config import keys
from zenoh_config.codec import pack, unpack
from zenoh_config.messages import MovementAuthority, PositionReport
from zenoh_config.sequencing import AuthorityGate

S_PER_NS: Final = 1e-9


class RadioLink:
    """Position reports out, movement authorities in."""

    def __init__(
        self,
        *,
        line_name: str,
        train: int,
        boot: int,
        max_age_s: float,
        train_length_m: float,
        seen_term: int = 0,
    ) -> None:
        self._train = train
        self._boot = boot
        self._length_m = train_length_m
        self._sequence = 0
        self._gate = AuthorityGate(
            train=train, boot=boot, max_age_ns=round(max_age_s / S_PER_NS), seen_term=seen_term
        )
        self._echo_ns = 0
        self.report_key = keys.report(line_name, train)
        self.subscriptions = (keys.authorities(line_name, train),)
        self.authority: Authority | None = None
        self.refused = 0
        """Radio messages that were not acted on."""

    @property
    def seen_term(self) -> int:
        return self._gate.seen_term

    def authority_age_s(self, now_ns: int) -> float:
        """By this train's clock, since it sent the report that the held authority answers."""
        return NEVER_S if self.authority is None else (now_ns - self._echo_ns) * S_PER_NS

    def take(self, now_ns: int, messages: Iterable[RadioMessage]) -> None:
        """Hold the newest authority that is for this train and in order; count the rest."""
        for message in messages:
            heard = unpack(message.payload)
            if not isinstance(heard, MovementAuthority) or self._gate.check(heard, now_ns):
                self.refused += 1
                continue
            self._echo_ns = heard.echo_stamp_ns
            self.authority = Authority(heard.end_m, heard.term, heard.sequence)

    def report(self, now_ns: int, output: CycleOutput) -> bytes | None:
        """Where the train is for certain; None while it does not know."""
        motion = output.motion
        if motion is None or not motion.localised:
            return None
        self._sequence += 1
        return pack(
            PositionReport(
                train=self._train,
                boot=self._boot,
                sequence=self._sequence,
                stamp_ns=now_ns,
                front_min_m=motion.front_m.low,
                front_max_m=motion.front_m.high,
                rear_min_m=motion.front_m.low - self._length_m,
                speed_mps=motion.speed_mps.best,
                standstill=motion.standstill,
            )
        )
