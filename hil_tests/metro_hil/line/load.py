"""Measures what many trains cost a master and the wayside, with encoding and decoding."""

from typing import Final

from firmware_py.clock.clock import WallClock
from firmware_py.ports import RadioMessage
from firmware_py.storage.checked_store import CheckedStore
from firmware_py.trackdb.areas import Area, AreaMap, TrackSection
from plant_emulator.wayside.line_wayside import Disks, LineWayside, WaysideTruth
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import OwnTrain, Role, T2tConfig, TrainMemory
from vobc.wire.line_radio import LineRadio
from zenoh_config import t2t_keys
from zenoh_config.codec import pack, unpack
from zenoh_config.t2t import BROADCAST, AreaAuthority, Heartbeat, RosterCommit, TrainReport

GAP_M: Final = 300.0
LENGTH_M: Final = 80.0
SECTION_M: Final = 150.0
AXLES: Final = 16
STEP_NS: Final = 10_000_000
REPORT_NS: Final = 100_000_000
NS_PER_MS: Final = 1e6
SETTLE_STEPS: Final = 6000
WAITING_STEPS: Final = 1500
CYCLES: Final = 50
SHARE_STEPS: Final = 500


class _Others:
    """Trains at rest that only send their reports."""

    def __init__(self, fronts_m: dict[int, float]) -> None:
        self._fronts_m = fronts_m
        self._given: dict[int, tuple[int, int, float]] = {}
        """Term, number and end of the newest authority, by train."""
        self._term = 0
        self._beat_ns = 0
        self._sequence = 0

    def on_message(self, payload: bytes) -> None:
        heard = unpack(payload)
        if isinstance(heard, Heartbeat):
            self._term = max(self._term, heard.term)
            self._beat_ns = heard.stamp_ns
        elif isinstance(heard, AreaAuthority):
            self._given[heard.destination] = (heard.term, heard.sequence, heard.end_m)

    @property
    def commanded(self) -> int:
        return len(self._given)

    def reports(self, now_ns: int) -> list[RadioMessage]:
        said = []
        for train, front_m in self._fronts_m.items():
            self._sequence += 1
            term, sequence, end_m = self._given.get(train, (0, 0, front_m))
            report = TrainReport(
                *(train, BROADCAST, 1, self._term, 1, self._sequence, now_ns),
                localised=True,
                front_min_m=front_m,
                front_max_m=front_m,
                rear_min_m=front_m - LENGTH_M,
                protected_m=front_m - LENGTH_M,
                speed_mps=0.0,
                standstill=True,
                latent_m=max(end_m, front_m),
                held_end_m=end_m,
                easy_m=front_m,
                held_term=term,
                held_sequence=sequence,
                member=term > 0,
                behind=0,
                comes_from=0,
                axles=AXLES,
                out_of_service=False,
                ready_nonce=0,
                echo_ns=self._beat_ns,
            )
            topic = t2t_keys.key_of("load", report)
            said.append(RadioMessage(now_ns, topic, pack(report)))
        return said


def cycle_ms(trains: int) -> list[float]:
    """Return the times of cycles in which the master issues authorities to all others.

    Each lasts from the last report to the bytes of the last authority. Raises TimeoutError if not
    all trains are commanded in time.
    """
    fronts_m = {n: GAP_M * (trains + 1 - n) for n in range(1, trains + 1)}
    line = _line(1, GAP_M * (trains + 2))
    core = TrainCore(T2tConfig(), line, address=1, memory=TrainMemory(), start_ns=0)
    radio = LineRadio(core, "load", lambda _: True)
    axles = _axles(list(fronts_m.values()))
    own = _at_rest(fronts_m.pop(1))
    return _run(_wayside_of(line), radio, own, _Others(fronts_m), axles)


def waiting_cycle_ms(trains: int) -> list[float]:
    """Return the times of the master's steps while every train reports and none may go.

    A train stands on every joint of sections, and a shadow train behind the last, so the master
    checks each train again after every report. Raises TimeoutError if not all are put on the
    roster.
    """
    fronts_m = {n: SECTION_M * (trains + 1 - n) + LENGTH_M / 2.0 for n in range(1, trains + 1)}
    line = _line(1, SECTION_M * (trains + 2))
    core = TrainCore(T2tConfig(), line, address=1, memory=TrainMemory(), start_ns=0)
    radio, wayside = LineRadio(core, "load", lambda _: True), _wayside_of(line)
    truth = _axles([*fronts_m.values(), SECTION_M - LENGTH_M])
    own = _at_rest(fronts_m.pop(1))
    others, clock = _Others(fronts_m), WallClock()
    took_ms, on_roster = list[float](), 0
    to_train: list[RadioMessage] = []
    for step in range(1, WAITING_STEPS):
        now_ns = step * STEP_NS
        reports = others.reports(now_ns) if now_ns % REPORT_NS == 0 else []
        begun_ns = clock.now_ns()
        radio.takes(to_train + reports)
        said = radio.step(now_ns, own, apply=True)
        if reports and on_roster == trains:
            took_ms.append((clock.now_ns() - begun_ns) / NS_PER_MS)
        heard = [RadioMessage(now_ns, key, payload) for key, payload in said]
        for each in heard:
            others.on_message(each.payload)
            message = unpack(each.payload)
            if isinstance(message, RosterCommit):
                on_roster = len(message.roster)
        to_train = [
            RadioMessage(now_ns, key, payload)
            for key, payload in wayside.step(now_ns, heard, truth)
        ]
    if len(took_ms) < CYCLES or others.commanded:
        raise TimeoutError(
            f"{on_roster} of {trains} are on the roster, {others.commanded} have an authority"
        )
    return took_ms[-CYCLES:]


def _line(areas: int, area_m: float) -> AreaMap:
    """Return areas one behind the other, with sections along the whole line."""
    sections = round(areas * area_m / SECTION_M)
    return AreaMap(
        "load",
        tuple([Area(n + 1, n * area_m, (n + 1) * area_m) for n in range(areas)]),
        tuple([TrackSection(n + 1, n * SECTION_M, (n + 1) * SECTION_M) for n in range(sections)]),
    )


def _wayside_of(line: AreaMap) -> LineWayside:
    config = T2tConfig()
    store = CheckedStore(None, ArbiterMemory)
    arbiter = config.arbiters[0]
    disks = Disks({arbiter: ArbiterMemory()}, {}, lambda _, m: store.put(m), lambda _, __: True)
    return LineWayside(config.timers, line, disks, boot=1, start_ns=0)


def _at_rest(front_m: float) -> OwnTrain:
    rear_m = front_m - LENGTH_M
    return OwnTrain(True, front_m, front_m, rear_m, rear_m, 0.0, True, front_m, front_m, AXLES)


def wayside_share(areas: int, trains_each: int) -> float:
    """Return the share of a processor that the wayside of a line takes.

    Each area has a master, which renews its lease and asks for the state of its sections, and the
    axles of `trains_each` trains.
    """
    line = _line(areas, GAP_M * trains_each)
    wayside = _wayside_of(line)
    masters, own = [], []
    for area in line.areas:
        front_m = (area.start_m + area.end_m) / 2.0
        core = TrainCore(T2tConfig(), line, address=area.number, memory=TrainMemory(), start_ns=0)
        masters.append(LineRadio(core, "load", lambda _: True))
        own.append(_at_rest(front_m))
    alone = _axles([each.front_max_m for each in own])
    crowd = _axles([GAP_M * (n + 0.5) for n in range(areas * trains_each)])
    clock, spent_ns = WallClock(), 0
    to_trains: list[RadioMessage] = []
    for step in range(1, 3 * SHARE_STEPS):
        now_ns = step * STEP_NS
        said: list[RadioMessage] = []
        for radio, train in zip(masters, own, strict=True):
            radio.takes(to_trains)
            said += [RadioMessage(now_ns, *e) for e in radio.step(now_ns, train, apply=True)]
        begun_ns = clock.now_ns()
        measured = step >= 2 * SHARE_STEPS
        answers = wayside.step(now_ns, said, crowd if measured else alone)
        spent_ns += (clock.now_ns() - begun_ns) * measured
        to_trains = [RadioMessage(now_ns, key, payload) for key, payload in answers]
    if not all(Role.MASTER in radio.roles.values() for radio in masters):
        raise TimeoutError("not every area has a master")
    return spent_ns / (SHARE_STEPS * STEP_NS)


def _run(
    wayside: LineWayside, radio: LineRadio, own: OwnTrain, others: _Others, truth: WaysideTruth
) -> list[float]:
    clock, took_ms = WallClock(), list[float]()
    to_train: list[RadioMessage] = []
    wanted = len(truth.axles) and len(others.reports(0))
    for step in range(1, SETTLE_STEPS):
        now_ns = step * STEP_NS
        if now_ns % REPORT_NS == 0:
            to_train += others.reports(now_ns)
        begun_ns = clock.now_ns()
        radio.takes(to_train)
        said = radio.step(now_ns, own, apply=True)
        spent_ms = (clock.now_ns() - begun_ns) / NS_PER_MS
        heard = [RadioMessage(now_ns, key, payload) for key, payload in said]
        authorities = sum("/aa/" in each.key for each in heard)
        for each in heard:
            others.on_message(each.payload)
        if authorities >= wanted and others.commanded >= wanted:
            took_ms.append(spent_ms)
            if len(took_ms) >= CYCLES:
                return took_ms
        to_train = [
            RadioMessage(now_ns, key, payload)
            for key, payload in wayside.step(now_ns, heard, truth)
        ]
    raise TimeoutError(f"only {others.commanded} of {wanted} trains are commanded")


def _axles(fronts_m: list[float]) -> WaysideTruth:
    """Return the axles of all trains, each counted at the middle of its train."""
    counted: dict[int, int] = {}
    for front_m in fronts_m:
        section = int((front_m - LENGTH_M / 2.0) // SECTION_M) + 1
        counted[section] = counted.get(section, 0) + AXLES
    return WaysideTruth(counted)
