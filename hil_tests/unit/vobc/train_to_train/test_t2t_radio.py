"""Trains that command themselves as bytes on the radio: state is stored first, then applied,
then sent."""

import dataclasses
from pathlib import Path

import pytest

from firmware_py.ports import RadioMessage
from firmware_py.radio.inproc_radio import InprocRadio, InprocRadioPort
from firmware_py.storage.checked_store import CheckedStore
from firmware_py.storage.nvram import NvramState
from firmware_py.trackdb.areas import Area, AreaMap, ObjectKind, ObjectSite, TrackSection
from plant_emulator.wayside.line_wayside import Disks, LineWayside, WaysideTruth
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory, ObjectMemory
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import AreaMemory, OwnTrain, Role, T2tConfig, TrainMemory
from vobc.wire.line_radio import LineRadio
from zenoh_config import t2t_keys
from zenoh_config.codec import pack, unpack
from zenoh_config.t2t import LeaseKind, LeaseRequest, TrainReport
from zenoh_config.timers import TIMERS_A

MS = 1_000_000
LINE = AreaMap(
    "Test line",
    (Area(1, 0.0, 4000.0),),
    tuple([TrackSection(n + 1, n * 200.0, n * 200.0 + 200.0) for n in range(20)]),
    (ObjectSite(1, ObjectKind.SWITCH, 2500.0, 2520.0),),
)
ARBITER = 65_001


def standing(front_m: float) -> OwnTrain:
    return OwnTrain(
        *(True, front_m, front_m, front_m - 80.0, front_m - 80.0, 0.0, True, front_m, front_m, 16)
    )


class Net:
    """A wayside and standing trains on the virtual radio; all messages are bytes."""

    def __init__(self, folder: Path, fronts_m: dict[int, float]) -> None:
        self.now_ns = 0
        self.radio = InprocRadio(0.005)
        self.folder = folder
        self.fronts_m = fronts_m
        arbiter = CheckedStore(folder / "arbiter", ArbiterMemory)
        switch = CheckedStore(folder / "switch", ObjectMemory)
        self.disk_full = False
        disks = Disks(
            {ARBITER: arbiter.value or ArbiterMemory()},
            {1: switch.value or ObjectMemory()},
            lambda _, memory: not self.disk_full and arbiter.put(memory),
            lambda _, memory: switch.put(memory),
        )
        self.wayside = LineWayside(TIMERS_A, LINE, disks, boot=1, start_ns=0)
        self.wayside_port = self.radio.port("wayside", self.wayside.subscriptions)
        self.trains: dict[int, tuple[LineRadio, InprocRadioPort]] = {}
        self.stores: dict[int, CheckedStore[TrainMemory]] = {}
        for address in fronts_m:
            store = self.stores[address] = CheckedStore(folder / f"{address}", TrainMemory)
            core = TrainCore(
                T2tConfig(), LINE, address=address, memory=store.value or TrainMemory(), start_ns=0
            )
            line_radio = LineRadio(core, LINE.name, store.put)
            port = self.radio.port(f"train {address}", line_radio.subscriptions)
            self.trains[address] = (line_radio, port)

    def run(self, ms: int) -> None:
        for _ in range(ms // 10):
            self.now_ns += 10 * MS
            for address, (line_radio, port) in self.trains.items():
                line_radio.takes(port.receive(self.now_ns))
                own = standing(self.fronts_m[address])
                apply = self.now_ns % (50 * MS) == 0
                for key, payload in line_radio.step(self.now_ns, own, apply=apply):
                    port.send(self.now_ns, key, payload)
                line_radio.tune(port)
            axles: dict[int, int] = {}
            for front_m in self.fronts_m.values():
                section = int((front_m - 40.0) // 200.0) + 1
                axles[section] = axles.get(section, 0) + 16
            heard = self.wayside_port.receive(self.now_ns)
            for key, payload in self.wayside.step(self.now_ns, heard, WaysideTruth(axles)):
                self.wayside_port.send(self.now_ns, key, payload)


def test_trains_find_each_other_over_the_radio_and_get_their_authorities(tmp_path: Path) -> None:
    net = Net(tmp_path, {1: 2190.0, 2: 1190.0, 3: 590.0})

    net.run(2000)

    ends_m = {a: line.authority and line.authority.end_m for a, (line, _) in net.trains.items()}
    assert ends_m == {1: 3989.0, 2: 2103.0, 3: 1103.0}
    roles = [line.roles[1] for line, _ in net.trains.values()]
    assert sorted(each.name for each in roles) == ["MASTER", "MEMBER", "STANDBY"]
    assert all(not line.refusals for line, _ in net.trains.values())


def test_refusals_of_arbiters_are_counted_by_the_wayside(tmp_path: Path) -> None:
    """A train that expects three arbiters asks them in vain, so no train commands."""
    net = Net(tmp_path, {1: 2190.0})
    config = T2tConfig(arbiters=(ARBITER, ARBITER + 1, ARBITER + 2))
    core = TrainCore(config, LINE, address=2, memory=TrainMemory(), start_ns=0)
    line_radio = LineRadio(core, LINE.name, lambda _: True)
    net.trains = {2: (line_radio, net.radio.port("train 2", line_radio.subscriptions))}
    net.fronts_m[2] = 1190.0

    net.run(2000)

    assert net.wayside.refused()["of other arbiters or timers"] > 2
    assert net.wayside.sources["of other arbiters or timers"].startswith("train ")
    assert line_radio.authority is None
    assert line_radio.refused() == {}


def test_terms_and_incarnations_survive_a_restart_on_the_disk(tmp_path: Path) -> None:
    Net(tmp_path, {1: 2190.0, 2: 1190.0}).run(2000)
    before = CheckedStore(tmp_path / "1", TrainMemory).value
    assert before is not None

    again = Net(tmp_path, {1: 2190.0, 2: 1190.0})
    again.run(2000)

    after = again.stores[1].value
    assert after is not None
    assert after.boot == before.boot + 1
    assert after.of_area(1).seen_term > before.of_area(1).seen_term
    assert all(line.authority is not None for line, _ in again.trains.values())


def test_an_arbiter_whose_disk_is_full_grants_nothing(tmp_path: Path) -> None:
    net = Net(tmp_path, {1: 2190.0})
    net.disk_full = True

    net.run(2000)

    assert net.wayside.failed == [f"arbiter {ARBITER}"]
    assert net.trains[1][0].roles[1] is not Role.MASTER


def asks(area: int) -> RadioMessage:
    """The request of train 5 to command an area."""
    head = (5, ARBITER, area, 1, 1, 1, 0)
    request = LeaseRequest(*head, LeaseKind.ACQUIRE, 1, 0, 0)
    return RadioMessage(0, t2t_keys.key_of(LINE.name, request), pack(request))


@pytest.mark.parametrize(("area", "refused"), [(0, 1), (1, 0), (2, 1), (255, 1)])
def test_only_areas_of_the_line_are_granted(tmp_path: Path, area: int, refused: int) -> None:
    wayside = Net(tmp_path, {}).wayside

    wayside.step(TIMERS_A.arbiter_lease_ns, [asks(area)], WaysideTruth({}))

    assert wayside.refusals["unknown area"] == refused
    assert wayside.sources == ({"unknown area": "train 5"} if refused else {})
    (arbiter,) = wayside.arbiters.values()
    assert [each.area for each in arbiter.memory.areas] == [area] * (1 - refused)


def line_radio(stored: list[TrainMemory], *, works: bool = True) -> LineRadio:
    def store(memory: TrainMemory) -> bool:
        stored.append(memory)
        return works

    core = TrainCore(T2tConfig(), LINE, address=4, memory=TrainMemory(), start_ns=0)
    return LineRadio(core, LINE.name, store)


def test_a_train_whose_disk_is_full_sends_nothing_until_its_state_is_stored() -> None:
    stored: list[TrainMemory] = []
    radio = line_radio(stored, works=False)

    assert radio.step(0, standing(500.0), apply=True) == []
    assert radio.step(200 * MS, standing(500.0), apply=True) == []
    assert len(stored) == 2
    assert radio.authority is None


def test_a_message_under_a_foreign_key_or_damaged_is_refused() -> None:
    radio = line_radio([])
    ((key, payload),) = radio.step(0, standing(500.0), apply=True)
    report = unpack(payload)
    assert isinstance(report, TrainReport)
    other = pack(dataclasses.replace(report, source=9))

    radio.takes([RadioMessage(0, key, other), RadioMessage(0, key, other[:-1] + b"\0")])

    assert radio.refusals == {"wrong source": 1, "wrong safety code": 1}


def test_a_flood_between_two_steps_is_bounded_and_counted() -> None:
    radio = line_radio([])
    ((key, payload),) = radio.step(0, standing(500.0), apply=True)
    flood = [RadioMessage(0, key, payload)] * 10_000

    radio.takes(flood)
    radio.step(10 * MS, standing(500.0), apply=True)

    assert radio.refusals == {"flood": 9000}


MEMORY = TrainMemory(7, (AreaMemory(1, 5, 3, 6),))


def test_a_checked_store_returns_the_stored_data(tmp_path: Path) -> None:
    path = tmp_path / "memory"
    assert CheckedStore(path, TrainMemory).state is NvramState.ABSENT
    assert CheckedStore(path, TrainMemory).put(MEMORY)

    found = CheckedStore(path, TrainMemory)

    assert (found.state, found.value) == (NvramState.OK, MEMORY)


@pytest.mark.parametrize("spoil", [b"", b"{}\n", b"x" * 50, b"\xff\xfe"])
def test_a_checked_store_rejects_data_that_it_did_not_write(tmp_path: Path, spoil: bytes) -> None:
    path = tmp_path / "memory"
    path.write_bytes(spoil)

    found = CheckedStore(path, TrainMemory)

    assert (found.state, found.value) == (NvramState.CORRUPT, None)
    assert str(path) in found.detail


def test_a_checked_store_detects_every_changed_byte(tmp_path: Path) -> None:
    path = tmp_path / "memory"
    CheckedStore(path, TrainMemory).put(MEMORY)
    whole = path.read_bytes()

    for at in range(len(whole) - 1):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        assert CheckedStore(path, TrainMemory).value is None


def test_a_store_that_cannot_write_reports_it(tmp_path: Path) -> None:
    store = CheckedStore(tmp_path / "no folder" / "memory", TrainMemory)

    assert not store.put(MEMORY)
    assert "cannot be written" in store.detail
