"""Arbiters and track as programs of their own: any one arbiter may die, and no train notices."""

from collections.abc import Callable

import pytest

from firmware_py.radio.inproc_radio import InprocRadio, InprocRadioPort
from firmware_py.storage.checked_store import CheckedStore
from hil_tests.unit.vobc.train_to_train.test_t2t_radio import LINE, MS, standing
from plant_emulator.wayside.grants import ObservedArbiter
from plant_emulator.wayside.line_wayside import Disks, LineWayside, WaysideTruth
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory, LeaseMemory, ObjectMemory
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import Role, T2tConfig, TrainMemory
from vobc.wire.line_radio import LineRadio
from zenoh_config import t2t_keys
from zenoh_config.codec import pack
from zenoh_config.t2t import Heartbeat, LeaseAnswer, Phase, RosterEntry
from zenoh_config.timers import TIMERS_A

ARBITERS = (65_001, 65_002, 65_003)
TRACK = 0
FRONTS_M = {1: 2190.0, 2: 1190.0, 3: 590.0}
AXLES = {11: 16, 6: 16, 3: 16}


class ApartNet:
    """Three standing trains, three arbiters and the track, each a program on the virtual radio."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.radio = InprocRadio(0.005)
        self.stores = {address: CheckedStore(None, ArbiterMemory) for address in ARBITERS}
        self.programs: dict[int, LineWayside | None] = {}
        self.ports: dict[int, InprocRadioPort] = {}
        for part in (*ARBITERS, TRACK):
            self.start(part)
        self.trains: dict[int, tuple[LineRadio, InprocRadioPort]] = {}
        config = T2tConfig(arbiters=ARBITERS)
        for address in FRONTS_M:
            store = CheckedStore(None, TrainMemory)
            core = TrainCore(config, LINE, address=address, memory=TrainMemory(), start_ns=0)
            line_radio = LineRadio(core, LINE.name, store.put)
            port = self.radio.port(f"train {address}", line_radio.subscriptions)
            self.trains[address] = (line_radio, port)

    def start(self, part: int) -> None:
        """Start a program with what it stored before."""
        own = {part: self.stores[part].value or ArbiterMemory()} if part != TRACK else {}
        disks = Disks(
            own,
            {1: ObjectMemory()} if part == TRACK else {},
            lambda address, memory: self.stores[address].put(memory),
            lambda _, __: True,
        )
        program = LineWayside(
            *(TIMERS_A, LINE, disks),
            boot=self.now_ns // MS + 1,
            start_ns=self.now_ns,
            arbiters=ARBITERS,
            serves_track=part == TRACK,
        )
        self.programs[part] = program
        if part not in self.ports:
            self.ports[part] = self.radio.port(f"part {part}", program.subscriptions)

    def run(self, ms: int, look: Callable[[], None] = lambda: None) -> None:
        for _ in range(ms // 10):
            self.now_ns += 10 * MS
            for address, (line_radio, port) in self.trains.items():
                line_radio.takes(port.receive(self.now_ns))
                apply = self.now_ns % (50 * MS) == 0
                own = standing(FRONTS_M[address])
                for key, payload in line_radio.step(self.now_ns, own, apply=apply):
                    port.send(self.now_ns, key, payload)
                line_radio.tune(port)
            for part, port in self.ports.items():
                heard, program = port.receive(self.now_ns), self.programs[part]
                if program is not None:
                    for key, payload in program.step(self.now_ns, heard, WaysideTruth(AXLES)):
                        port.send(self.now_ns, key, payload)
            look()

    @property
    def roles(self) -> dict[int, Role]:
        return {address: line.roles[1] for address, (line, _) in self.trains.items()}

    @property
    def ages_ms(self) -> list[float]:
        """Age of each train's authority; nothing if a train has none."""
        held = [line.authority for line, _ in self.trains.values()]
        return [(self.now_ns - each.echo_ns) / MS for each in held if each is not None]


def test_programs_of_their_own_command_a_line_as_one_program_does() -> None:
    net = ApartNet()

    net.run(2000)

    ends_m = {a: line.authority and line.authority.end_m for a, (line, _) in net.trains.items()}
    assert ends_m == {1: 3989.0, 2: 2103.0, 3: 1103.0}
    assert {*net.roles.values()} == {Role.MASTER, Role.MEMBER, Role.STANDBY}
    for program in net.programs.values():
        assert program is not None
        assert program.refused() == {}


@pytest.mark.parametrize("arbiter", ARBITERS)
def test_an_arbiter_may_be_killed_and_started_again_after_3_s(arbiter: int) -> None:
    net = ApartNet()
    net.run(2000)
    roles = net.roles
    ages_ms = list[float]()

    net.programs[arbiter] = None
    net.run(3000, lambda: ages_ms.append(max(net.ages_ms)))
    net.start(arbiter)
    net.run(1000, lambda: ages_ms.append(max(net.ages_ms)))

    # The service brake comes at 60 % of the life of an authority.
    assert max(ages_ms) < 0.6 * TIMERS_A.authority_ms
    assert len(net.ages_ms) == len(FRONTS_M)
    assert net.roles == roles
    restarted = net.programs[arbiter]
    assert restarted is not None
    lease = restarted.arbiters[arbiter].lease(1)
    assert roles[lease.holder] is Role.MASTER


def test_without_a_majority_of_arbiters_no_train_commands() -> None:
    net = ApartNet()
    net.run(2000)

    net.programs[ARBITERS[0]] = net.programs[ARBITERS[1]] = None
    net.run(1500)

    assert Role.MASTER not in net.roles.values()


def test_the_track_obeys_a_term_only_from_the_train_to_which_an_arbiter_granted_it() -> None:
    net = ApartNet()
    net.run(2000)
    (master,) = [a for a, role in net.roles.items() if role is Role.MASTER]
    hostile = next(a for a in net.trains if a != master)
    beat = Heartbeat(hostile, 0xFFFF, 1, 9, 1, 1, net.now_ns, Phase.ISSUING, 0, 1)
    _, port = net.trains[hostile]
    track = net.programs[TRACK]
    assert track is not None

    port.send(net.now_ns, t2t_keys.key_of(LINE.name, beat), pack(beat))
    net.run(50)

    assert track.refused()["term not granted"] >= 1
    assert track.sources["term not granted"] == f"train {hostile}"


def test_a_restarted_track_learns_from_the_next_renewals_who_commands() -> None:
    net = ApartNet()
    net.run(2000)
    roles = net.roles
    ages_ms = list[float]()

    net.programs[TRACK] = None
    net.run(500, lambda: ages_ms.append(max(net.ages_ms)))
    net.start(TRACK)
    net.run(1000, lambda: ages_ms.append(max(net.ages_ms)))

    assert max(ages_ms) < 0.6 * TIMERS_A.authority_ms
    assert net.roles == roles
    track = net.programs[TRACK]
    assert track is not None
    # Heartbeats before the first renewal are refused, later ones are not.
    refused = track.refused()["term not granted"]
    net.run(500)
    assert track.refused()["term not granted"] == refused


def answer(term: int, holder: int, *, source: int = 65_001, version: int = 0) -> LeaseAnswer:
    roster = (RosterEntry(holder, 1.0, True),) if version else ()
    head = (source, holder, 1, term, 1, 1, 0)
    return LeaseAnswer(*head, True, 1, 0, holder, 0, term if version else 0, version, roster)


def test_an_old_answer_or_one_of_another_arbiter_changes_nothing() -> None:
    observed = ObservedArbiter(65_001)

    assert observed.on_answer(answer(4, 2, version=3)) == (
        LeaseMemory(1),
        LeaseMemory(1, 4, 2, 0, 4, 3, (RosterEntry(2, 1.0, True),)),
    )
    assert observed.on_answer(answer(4, 2)) is None
    assert observed.on_answer(answer(3, 1)) is None
    assert observed.on_answer(answer(9, 1, source=65_002)) is None
    before = Heartbeat(2, 0xFFFF, 1, 4, 1, 1, 0, Phase.ISSUING, 0, 1)
    assert observed.has_granted(before)
    changed = observed.on_answer(answer(5, 1))
    assert changed is not None
    assert changed[1].roster_version == 3
    assert not observed.has_granted(before)
