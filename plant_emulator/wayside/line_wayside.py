"""The wayside of a line whose trains command themselves, on the radio: arbiters, objects and
track.
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import NamedTuple

from firmware_py.ports import RadioMessage
from firmware_py.trackdb.areas import AreaMap
from plant_emulator.wayside.arbiter import Arbiter, of_masters
from plant_emulator.wayside.grants import Grants, ObservedArbiter
from plant_emulator.wayside.line_centre import LineCentre
from plant_emulator.wayside.line_object import LineObject
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory, CentreMemory, ObjectMemory
from plant_emulator.wayside.track import WaysideTrack
from zenoh_config import t2t_keys
from zenoh_config.codec import BENCH_KEY, SafetyKey, pack, unpack
from zenoh_config.messages import WAYSIDE, Refused, TrainStatus
from zenoh_config.t2t import LeaseAnswer, T2tMessage
from zenoh_config.t2t_supervision import Decree, TrainDecree
from zenoh_config.term_grants import GrantSigner
from zenoh_config.timers import LineTimers


def _store_nothing(_: CentreMemory) -> bool:
    """Store nothing and report success; for lines without a centre or disk."""
    return True


class Disks(NamedTuple):
    """The memories at the start, and functions that store them; each returns whether it stored."""

    arbiters: Mapping[int, ArbiterMemory | None]
    """By address; None means that the memory is unreadable."""
    objects: Mapping[int, ObjectMemory | None]
    store_arbiter: Callable[[int, ArbiterMemory], bool]
    store_object: Callable[[int, ObjectMemory], bool]
    store_centre: Callable[[CentreMemory], bool] = _store_nothing


class WaysideTruth(NamedTuple):
    """The state that the wayside's own detectors and dispatchers report."""

    axles: Mapping[int, int]
    """Number of axles by section."""
    occupied: Collection[int] = ()
    """Objects with a train in them."""
    release_wanted: Collection[int] = ()
    """Objects that are requested to move or open."""
    failed: Collection[int] = ()
    """Objects that are not proven to lie as they are locked, such as a switch that lost its
    detection."""


class LineWayside:
    """All parts of a line's wayside, or those that one program serves."""

    def __init__(
        self,
        timers: LineTimers,
        line: AreaMap,
        disks: Disks,
        *,
        boot: int,
        start_ns: int,
        centre: LineCentre | None = None,
        key: SafetyKey = BENCH_KEY,
        database: int | None = None,
        arbiters: Collection[int] | None = None,
        serves_track: bool = True,
        signers: Mapping[int, GrantSigner] | None = None,
    ) -> None:
        """Args:
        arbiters: addresses of all arbiters of the line; None: those of `disks`. Of those that this
            program does not serve it knows the grants by their answers on the radio.
        serves_track: this program serves objects, axle counters and centre.
        database: version of the track database; messages of another one are refused.
        signers: sign the grants, by the arbiter's address; None on a line that is not secured.
        boot: number of starts of this wayside; it must increase with every start.
        centre: stores the commands of supervision; without it they are ignored.
        """
        self.refusals: Counter[str] = Counter()
        self.sources: dict[str, str] = {}
        """Sender of the last refused message, by reason, as its key names it."""
        self.failed: list[str] = []
        """Names of parts that stopped because the disk did not store their memory."""
        others = frozenset(arbiters or disks.arbiters) - {*disks.arbiters}
        self.arbiters = {
            address: Arbiter(
                timers,
                address=address,
                memory=memory,
                start_ns=start_ns,
                arbiters=len(disks.arbiters) + len(others),
                signer=None if signers is None else signers[address],
            )
            for address, memory in disks.arbiters.items()
        }
        self._observed = {address: ObservedArbiter(address) for address in others if serves_track}
        self._granting: tuple[Grants, ...] = (*self.arbiters.values(), *self._observed.values())
        """Arbiters whose grants count, also after the disk failed one of them."""
        self.objects = {
            site.number: LineObject(
                timers,
                site,
                line.area_at(site.start_m).number,
                memory=disks.objects.get(site.number, ObjectMemory()),
                start_ns=start_ns,
            )
            for site in line.objects
            if serves_track
        }
        self.track = WaysideTrack(timers, line, boot=boot, start_ns=start_ns)
        self.centre = centre
        self.serves_track = serves_track
        self.subscriptions = (
            *(t2t_keys.of_wayside(line.name) if serves_track else ()),
            *(t2t_keys.of_grants(line.name) if self._observed else ()),
            *[
                each
                for address in self.arbiters
                for each in t2t_keys.of_arbiter(line.name, address)
            ],
        )
        self._line_name, self._disks, self._key = line.name, disks, key
        self._database = database
        self._areas = frozenset([area.number for area in line.areas])

    def step(
        self, now_ns: int, messages: Iterable[RadioMessage], truth: WaysideTruth
    ) -> list[tuple[str, bytes]]:
        """Return key and payload of all messages to send, after storing what they depend on."""
        heard, orders = self._opened(messages, now_ns)
        out: list[T2tMessage] = []
        for address, arbiter in list(self.arbiters.items()):
            mine = tuple([each for each in heard if each.destination == address])
            before = arbiter.memory
            decided = arbiter.step(now_ns, mine)
            if self.centre is not None and decided.memory is not None:
                self._note(before, decided.memory, now_ns)
            if decided.memory is None or self._disks.store_arbiter(address, decided.memory):
                out += decided.out
            else:
                self._fails(f"arbiter {address}")
                del self.arbiters[address]
        if not self.serves_track:
            return self._sealed(out)
        others = [each for each in heard if each.destination not in self.arbiters]
        # A wayside without arbiters cannot tell who commands.
        majority = len(self._granting) // 2 + 1
        if self._granting:
            to_wayside = tuple(of_masters(self._granting, others, majority=majority))
        else:
            to_wayside = tuple(others)
        if len(others) > len(to_wayside):
            known = {id(each) for each in to_wayside}
            for each in others:
                if id(each) not in known:
                    self._refuse("term not granted", t2t_keys.key_of(self._line_name, each))
        for number, site in list(self.objects.items()):
            moved = site.step(
                now_ns,
                to_wayside,
                release_wanted=number in truth.release_wanted,
                occupied=number in truth.occupied,
                failed=number in truth.failed,
            )
            if moved.memory is None or self._disks.store_object(number, moved.memory):
                out += moved.out
            else:
                self._fails(f"object {number}")
                del self.objects[number]
        out += self._decreed(now_ns, to_wayside)
        out += self.track.step(now_ns, to_wayside, axles=truth.axles)
        return orders + self._sealed(out)

    def _sealed(self, out: Iterable[T2tMessage]) -> list[tuple[str, bytes]]:
        return [
            (t2t_keys.key_of(self._line_name, m), pack(m, self._key, database=self._database))
            for m in out
        ]

    def refused(self) -> Counter[str]:
        """Number of refused messages so far, by reason."""
        found = self.refusals.copy()
        for arbiter in self.arbiters.values():
            found.update({each.value: n for each, n in arbiter.gate.refusals.items()})
            for reason, source in arbiter.gate.sources.items():
                self.sources[reason.value] = t2t_keys.sender_text(source)
        return found

    def _refuse(self, reason: str, key: str) -> None:
        self.refusals[reason] += 1
        self.sources[reason] = t2t_keys.sender_text(t2t_keys.writer_of(key))

    def _note(self, before: ArbiterMemory, after: ArbiterMemory, now_ns: int) -> None:
        """Pass an arbiter's grants to the centre, for displays."""
        assert self.centre is not None
        known = {each.area: each for each in before.areas}
        for each in after.areas:
            self.centre.granted(known.get(each.area), each, now_ns)

    def _decreed(self, now_ns: int, heard: tuple[T2tMessage, ...]) -> list[T2tMessage]:
        """Store commands before they take effect; a command that the disk does not store has no
        effect.
        """
        centre = self.centre
        if centre is None:
            return []
        before = centre.memory
        stepped = centre.step(now_ns, heard)
        out = list(stepped.out)
        if stepped.memory is not None and not self._disks.store_centre(stepped.memory):
            out = [centre.not_stored(before, now_ns)]
        self.track.restrictions, self.track.closed = centre.restrictions, centre.closed
        return out

    def take_orders(self, lasting: Iterable[TrainDecree]) -> None:
        """Take and store commands to trains that were given on another path of the network."""
        if self.centre is None:
            return
        before = self.centre.memory
        self.centre.take(lasting)
        now = self.centre.memory
        if now != before and not self._disks.store_centre(now):
            self._fails("centre")

    def _fails(self, who: str) -> None:
        """Stop a part whose memory could not be stored.

        It sends and moves nothing, so a restart finds it unchanged.
        """
        self.failed.append(who)

    def _observe(self, answer: LeaseAnswer, now_ns: int) -> None:
        """Note what an arbiter of another program granted."""
        observed = self._observed.get(answer.source)
        changed = None if observed is None else observed.on_answer(answer)
        if changed is not None and self.centre is not None:
            before, now = changed
            self.centre.granted(before, now, now_ns)

    def _opened(
        self, messages: Iterable[RadioMessage], now_ns: int
    ) -> tuple[list[T2tMessage], list[tuple[str, bytes]]]:
        """Return the messages of this protocol, and the centre's answers to statuses of trains."""
        heard: list[T2tMessage] = []
        orders: list[tuple[str, bytes]] = []
        for message in messages:
            opened = unpack(message.payload, self._key, database=self._database)
            if isinstance(opened, Refused):
                self._refuse(opened.reason.value, message.key)
            elif isinstance(opened, TrainStatus) and self.centre is not None:
                answer = self.centre.answer(message, opened, now_ns)
                orders += [] if answer is None else [answer]
            elif not isinstance(opened, T2tMessage) or opened.source == WAYSIDE:
                self._refuse("not for the wayside", message.key)
            elif message.key != t2t_keys.key_of(self._line_name, opened):
                self._refuse("wrong source", message.key)
            elif opened.area not in self._areas and not isinstance(opened, Decree):
                # Refuse it, so that it is not granted, stored and shown as an area that a train can
                # command.
                self._refuse("unknown area", message.key)
            elif isinstance(opened, LeaseAnswer):
                self._observe(opened, now_ns)
            else:
                heard.append(opened)
        return heard, orders
