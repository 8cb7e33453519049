"""Radio link of the train: position reports out, movement authorities in."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, Final

from firmware_py.ports import RadioMessage
from vobc.vocabulary import (
    S_PER_NS,
    Authority,
    CycleInput,
    CycleOutput,
    Orders,
    Received,
    Restriction,
    Source,
)
from vobc.wire.evidence import Evidence
from vobc.wire.refusals import Refusals
from zenoh_config import keys
from zenoh_config.codec import BENCH_KEY, SafetyKey, pack, unpack
from zenoh_config.messages import (
    MovementAuthority,
    PositionReport,
    Refused,
    TrainOrders,
    TrainStatus,
)
from zenoh_config.sequencing import AuthorityGate, OrdersGate

ORDERS_AGE_MAX_S: Final = 5.0
"""Age above which orders are refused on arrival. Protection limits the age of stored orders."""

Receiver = Callable[[Any, RadioMessage, int], Refused | None]
"""Stores a message of one kind, or says why it must not be used."""


class RadioLink:
    """Radio link for position reports, status, movement authorities and orders."""

    def __init__(
        self,
        *,
        line_name: str,
        train: int,
        boot: int,
        max_age_s: float,
        train_length_m: float,
        database: int,
        parameters: int,
        seen_term: int = 0,
        key: SafetyKey = BENCH_KEY,
    ) -> None:
        """Args:
        database: version of the track database; messages of another one are refused.
        parameters: version of the vital parameters; authorities for others are refused.
        """
        self._key, self._database, self._parameters = key, database, parameters
        self._train = train
        self._boot = boot
        self._length_m = train_length_m
        self._sequence = 0
        self._gate = AuthorityGate(
            train=train,
            boot=boot,
            max_age_ns=round(max_age_s / S_PER_NS),
            seen_term=seen_term,
            parameters=parameters,
        )
        self._orders_gate = OrdersGate(
            train=train, boot=boot, max_age_ns=round(ORDERS_AGE_MAX_S / S_PER_NS)
        )
        self._receivers: Mapping[type, Receiver] = {
            MovementAuthority: self._take_authority,
            TrainOrders: self._take_orders,
            Refused: lambda refused, _message, _now_ns: refused,
        }
        self._echo_ns = 0
        self._orders_echo_ns = 0
        self._statuses = 0
        self.report_key = keys.report(line_name, train)
        self.status_key = keys.status(line_name, train)
        self.subscriptions = (keys.authorities(line_name, train), keys.orders(line_name, train))
        self.authority: Authority | None = None
        self.orders: Orders | None = None
        self._told_orders: Orders | None = None
        """Orders as received from the centre."""
        self.authority_evidence: Evidence | None = None
        self.orders_evidence: Evidence | None = None
        self.refused = 0
        """Number of radio messages that were refused."""
        self.refusals = Refusals()
        """The same number by reason."""

    @property
    def seen_term(self) -> int:
        return self._gate.seen_term

    @property
    def received_authority(self) -> Received[Authority] | None:
        """The held authority. Its age counts from the report of this train that it answers."""
        return None if self.authority is None else Received(self.authority, self._echo_ns)

    @property
    def received_orders(self) -> Received[Orders] | None:
        """The held orders. Their age counts from the status of this train that they answer."""
        return None if self.orders is None else Received(self.orders, self._orders_echo_ns)

    def hold(
        self, authority: Authority | None, echo_ns: int, restrictions: tuple[Restriction, ...]
    ) -> None:
        """Use an authority with restrictions from another source than a zone controller.

        The restrictions join those of the centre. Before the first orders there are none, and no
        full supervision.
        """
        self.authority, self._echo_ns = authority, echo_ns
        if self._told_orders is not None:
            joined = (*self._told_orders.restrictions, *restrictions)
            self.orders = replace(self._told_orders, restrictions=joined)

    def take(self, now_ns: int, messages: Iterable[RadioMessage]) -> None:
        """Store the newest valid authority and orders for this train. Refused messages are
        counted.
        """
        for message in messages:
            heard = unpack(message.payload, self._key, database=self._database)
            receive = self._receivers.get(type(heard))
            if receive is None:
                self._refuse("not for a train", type(heard).__name__)
                continue
            refused = receive(heard, message, now_ns)
            if refused is not None:
                self._refuse(refused.reason.value, refused.detail)

    def _refuse(self, reason: str, detail: str) -> None:
        self.refused += 1
        self.refusals.note(0, reason, detail)

    def _take_authority(
        self, heard: MovementAuthority, message: RadioMessage, now_ns: int
    ) -> Refused | None:
        refused = self._gate.check(heard, now_ns)
        if refused is not None:
            return refused
        self._echo_ns = heard.echo_stamp_ns
        self.authority = Authority(heard.end_m, heard.term, heard.sequence, heard.rear_m)
        self.authority_evidence = Evidence(
            Source.AUTHORITY, heard.sequence, message.payload, message.stamp_ns
        )
        return None

    def _take_orders(
        self, heard: TrainOrders, message: RadioMessage, now_ns: int
    ) -> Refused | None:
        refused = self._orders_gate.check(heard, now_ns)
        if refused is not None:
            return refused
        self.orders_evidence = Evidence(
            Source.ORDERS, heard.sequence, message.payload, message.stamp_ns
        )
        self._orders_echo_ns = heard.echo_stamp_ns
        self.orders = self._told_orders = Orders(
            awake=heard.awake,
            hold=heard.hold,
            skip_next=heard.skip_next,
            stop_next=heard.stop_next,
            emergency=heard.emergency,
            releases=heard.releases,
            released_emergency=heard.released_emergency,
            creep=heard.creep,
            restricted=heard.restricted,
            doors_left=heard.doors_left,
            doors_right=heard.doors_right,
            platform_doors_locked=heard.platform_doors_locked,
            restrictions=tuple(
                [
                    Restriction(each.start_m, each.end_m, each.limit_mps)
                    for each in heard.restrictions
                ]
            ),
        )
        return None

    def status(self, now_ns: int, output: CycleOutput, inputs: CycleInput | None) -> bytes:
        """Status message for centre and platforms, whether localised or not."""
        self._statuses += 1
        motion = output.motion
        localised = motion is not None and motion.localised
        desk = None if inputs is None else inputs.desk
        doors = None if inputs is None else inputs.doors
        alarms = None if inputs is None else inputs.alarms
        return pack(
            TrainStatus(
                train=self._train,
                boot=self._boot,
                sequence=self._statuses,
                stamp_ns=now_ns,
                mode=output.mode,
                supervision=output.supervision,
                cause=output.emergency_cause,
                localised=localised,
                standstill=motion is not None and motion.standstill,
                front_m=motion.front_m.best if motion is not None and localised else 0.0,
                doors_locked=doors is not None and doors.closed_and_locked,
                open_left=output.open_left,
                open_right=output.open_right,
                passenger_alarm=desk is not None and not desk.no_passenger_alarm,
                fire=alarms is not None and not alarms.no_fire,
                obstacle=alarms is not None and not alarms.no_obstacle,
                alarm_raised=output.alarm_raised,
                emergency_number=output.emergency_number,
            ),
            self._key,
            database=self._database,
        )

    def report(self, now_ns: int, output: CycleOutput) -> bytes | None:
        """Position report. None: the train does not know its place."""
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
                parameters=self._parameters,
            ),
            self._key,
            database=self._database,
        )
