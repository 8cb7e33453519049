"""Commands of supervision to trains on a network, from the console to the controller."""

import dataclasses
from argparse import Namespace
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Final

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.ports import LinkCounters, RadioMessage
from firmware_py.trackdb.circuit import load_network, load_path
from firmware_py.trackdb.paths import Path as Way
from firmware_py.trackdb.version import database_version
from hil_tests.unit.metro_hil.line.test_network_witness import OUT
from hil_tests.unit.metro_hil.line.test_turning_masters import SHORT, SHORT_TRACKS, T2T, written
from hil_tests.unit.metro_hil.supervision.test_line_supervision import REPORT
from hil_tests.unit.plant_emulator.wayside.test_line_centre import STATUS
from metro_hil.cli.vobc import main
from metro_hil.line.turning.central_orders import CentralOrders
from metro_hil.model.run_options import EXIT_ENVIRONMENT, EXIT_OK, EXIT_USAGE
from metro_hil.supervision.command import show_network
from metro_hil.supervision.network import NetworkDesk, PathSessions, SupervisedPath, text_of
from plant_emulator.wayside.departed_trains import DepartedTrains
from plant_emulator.wayside.line_centre import LineCentre
from plant_emulator.wayside.line_wayside import Disks, LineWayside
from plant_emulator.wayside.network_places import key_of_place
from plant_emulator.wayside.network_wayside import NetworkWayside, PathWayside
from plant_emulator.wayside.railway import Railway
from plant_emulator.wayside.route_objects import divided
from plant_emulator.wayside.separation import Stretch
from plant_emulator.wayside.t2t_vocabulary import CentreMemory
from zenoh_config import keys
from zenoh_config.codec import BENCH_KEY, pack, unpack
from zenoh_config.messages import TrainOrders, TrainStatus
from zenoh_config.t2t import SUPERVISION
from zenoh_config.t2t_keys import key_of
from zenoh_config.t2t_supervision import Decree, DecreeKind, LineState

MS: Final = 1_000_000
SECRET: Final = b"the key of a secured line, of 32"
SERVICE: Final = "docs/examples/line/shuttle.toml"


@pytest.fixture(scope="module")
def ways(tmp_path_factory: pytest.TempPathFactory) -> list[Way]:
    file = written(tmp_path_factory.mktemp("network"), SHORT, SHORT_TRACKS)
    return [load_path(f"{file}:out"), load_path(f"{file}:back")]


class Wayside:
    """The wayside of a network, with the centre of each path."""

    def __init__(self, ways: Sequence[Way], folder: Path) -> None:
        network = load_network(written(folder, SHORT, SHORT_TRACKS))
        self.stored: dict[str, CentreMemory] = {}
        self.now_ns, self._sequence = 10_000 * MS, 0
        self.state: LineState | None = None
        paths = []
        for way in ways:
            name, database = way.line.name, database_version(way.line)
            areas = divided(network, way)
            disks = Disks({}, {}, lambda a, m: True, lambda n, m: True, self._stores(name))
            centre = LineCentre(way.line, boot=5)
            wayside = LineWayside(
                *(T2T.timers, areas, disks), boot=5, start_ns=0, centre=centre, database=database
            )
            departed = DepartedTrains(name, database=database)
            paths.append(PathWayside(way, areas, wayside, departed))
        self.network = NetworkWayside(network, paths, start_ns=0)

    def _stores(self, name: str):  # type: ignore[no-untyped-def]
        def store(memory: CentreMemory) -> bool:
            self.stored[name] = memory
            return True

        return store

    def step(self, *messages: tuple[str, bytes]) -> list[tuple[str, bytes]]:
        self.now_ns += 600 * MS
        heard = [RadioMessage(self.now_ns, key, payload) for key, payload in messages]
        out = self.network.step(self.now_ns, heard)
        states = [unpack(payload) for _, payload in out]
        self.state = next((each for each in states if isinstance(each, LineState)), None)
        return out

    def order(self, way: Way, status: TrainStatus) -> TrainOrders:
        """The answer to a status of train 3 on a path."""
        database = database_version(way.line)
        key = keys.status(way.line.name, 3)
        out = self.step((key, pack(status, database=database)))
        (found,) = [each for each in (unpack(p) for _, p in out) if isinstance(each, TrainOrders)]
        return found

    def command(self, way: Way, kind: DecreeKind) -> None:
        assert self.state is not None
        self._sequence += 1
        head = (SUPERVISION, 0, 0, 0, 1, self._sequence, self.now_ns)
        decree = Decree(*head, self.state.stamp_ns, kind, 3, 0.0, 0.0, 0.0)
        database = database_version(way.line)
        self.step((key_of(way.line.name, decree), pack(decree, database=database)))

    def enters(self, way: Way, trip: int) -> None:
        place = msgspec.structs.replace(OUT, path=way.line.name, trip=trip)
        self.step((key_of_place("short", 3), msgspec.json.encode(place)))


def test_a_command_to_a_train_holds_on_its_next_path_and_a_skip_order_does_not(
    ways: list[Way], tmp_path: Path
) -> None:
    wayside, (out, back) = Wayside(ways, tmp_path), ways
    wayside.enters(out, 0)
    assert not wayside.order(out, dataclasses.replace(STATUS, front_m=10.0)).hold

    wayside.command(out, DecreeKind.HOLD)
    wayside.command(out, DecreeKind.SKIP)
    both = wayside.order(out, dataclasses.replace(STATUS, sequence=9, front_m=10.0, stamp_ns=9))
    assert (both.hold, both.skip_next) == (True, True)
    # The controller of the next trip counts its statuses from 0 again.
    wayside.enters(back, 1)
    held = wayside.order(back, dataclasses.replace(STATUS, front_m=10.0))
    assert (held.hold, held.skip_next) == (True, False)
    wayside.command(back, DecreeKind.LET_GO)
    wayside.enters(out, 2)
    freed = wayside.order(out, dataclasses.replace(STATUS, front_m=10.0))

    assert (freed.hold, freed.skip_next) == (False, False)
    for name in ("short-out", "short-back"):
        (stored,) = wayside.stored[name].trains
        assert (stored.train, stored.hold) == (3, False)


class Session:
    def __init__(self) -> None:
        self.sent: list[tuple[str, bytes]] = []
        self.order: RadioMessage | None = None

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        self.sent.append((key, payload))


ORDERS: Final = TrainOrders(
    *(3, 1, 1, 700, True, True, False, False, True, 2, False, False, True, True, False),
    released_emergency=4,
)


def test_the_trains_own_centre_repeats_what_the_centre_orders_and_no_older_order(
    ways: list[Way],
) -> None:
    line, session = ways[0].line, Session()
    database = database_version(line)
    railway = Railway(line, line.stations[-1])
    central = CentralOrders(session, railway, line, SECRET)

    def receive(orders: TrainOrders) -> None:
        session.order = RadioMessage(0, "", pack(orders, SECRET, database=database))
        central.obey(3)

    receive(dataclasses.replace(ORDERS, train=4))
    assert not railway.centre.standing.hold
    receive(ORDERS)
    standing = railway.centre.standing
    assert (standing.hold, standing.emergency, standing.skip_next) == (True, True, False)
    assert (railway.centre.releases, railway.centre.released_emergency) == (2, 4)
    receive(dataclasses.replace(ORDERS, hold=False))
    assert railway.centre.standing.hold
    receive(dataclasses.replace(ORDERS, hold=False, echo_stamp_ns=701))
    assert not railway.centre.standing.hold

    # Each status of the controller goes to both centres.
    key = keys.status(line.name, 3)
    status = pack(STATUS, SECRET, database=database)
    ((_, answer),) = railway.answers([RadioMessage(5, key, status)], 5)
    assert isinstance(unpack(answer, SECRET, database=database), TrainOrders)
    assert session.sent == [(key, status)]


@given(st.floats(0.0, 369.0), st.floats(0.1, 369.0))
def test_a_stretch_is_as_long_on_each_path_and_translates_back(
    ways: list[Way], start_m: float, length_m: float
) -> None:
    out, back = ways
    end_m = min(out.line.end_m, start_m + length_m)
    stretch = Stretch(out, start_m, end_m)

    ((low_m, high_m),) = stretch.pieces_on(out)
    assert (low_m, high_m) == pytest.approx((start_m, end_m), abs=2e-6)
    for low_m, high_m in stretch.pieces_on(back):
        # The tracks of both paths are one siding at each end, of 100 m.
        for piece_m in Stretch(back, low_m, high_m).pieces_on(out):
            assert start_m - 2e-6 <= piece_m[0] <= piece_m[1] <= end_m + 2e-6
            assert piece_m[1] - piece_m[0] == pytest.approx(high_m - low_m, abs=4e-6)


class Radio:
    """A session on which messages wait."""

    def __init__(self, messages: Collection[RadioMessage] = ()) -> None:
        self.counters, self.waiting = LinkCounters(), list(messages)
        self.sent: list[str] = []

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        self.sent.append(key)

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        found, self.waiting = self.waiting, []
        return found

    def close(self) -> None:
        pass


def test_each_path_receives_its_own_messages_whichever_asks_first() -> None:
    names = ["short-out", "short-back"]
    radio = Radio([RadioMessage(0, f"m/{name}/w/1/hb/1/all", b"") for name in (*names, "loop")])
    sessions = PathSessions(radio, names)

    back = sessions.ports["short-back"].receive(0)
    out = sessions.ports["short-out"].receive(0)

    assert [each.key for each in back] == ["m/short-back/w/1/hb/1/all"]
    assert [each.key for each in out] == ["m/short-out/w/1/hb/1/all"]
    assert sessions.ports["short-out"].receive(0) == []


class Instants:
    def __init__(self) -> None:
        self.at_ns = 0

    def now_ns(self) -> int:
        return self.at_ns

    def epoch_ns(self) -> int:
        return 1_000 * MS

    def wait_until(self, at_ns: int) -> None:
        self.at_ns = at_ns


def test_a_command_to_a_train_goes_to_its_path_and_one_for_track_to_all_paths_over_it(
    ways: list[Way], tmp_path: Path
) -> None:
    network = load_network(written(tmp_path, SHORT, SHORT_TRACKS))
    paths = [SupervisedPath(way.line.name[6:], way, divided(network, way)) for way in ways]
    radio = Radio()
    desk = NetworkDesk(paths, radio, Instants(), BENCH_KEY)  # type: ignore[arg-type]
    assert desk.of_train(3) is None

    for name in ("short-out", "short-back"):
        report = dataclasses.replace(REPORT, area=1)
        radio.waiting.append(RadioMessage(0, key_of(name, report), pack(report)))
        desk.listen(0.1)
    found = desk.of_train(3)
    assert found is not None
    assert found.of.route == "back"
    assert text_of(desk.only(None), lambda view: [f"{len(view.reports)}"]) == [
        *("short-out:", "1"),
        *("short-back:", "1"),
    ]
    assert desk.only(paths[1]) == [found]

    # 40 m to 130 m on the path out: 60 m of the siding at its start, and the east track.
    pieces: list[tuple[float, float]] = []

    def act(_: object, start_m: float, end_m: float) -> int:
        pieces.append((start_m, end_m))
        return EXIT_OK if len(pieces) < 2 else EXIT_ENVIRONMENT

    stretch = Stretch(ways[0], 40.0, 130.0)
    assert desk.on_stretch(stretch, act) == EXIT_ENVIRONMENT
    assert pieces == [(40.0, 130.0), (270.0, 330.0)]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["hold", "1", "--line", "loop"], "--line: not with --service"),
        (["restrict", "0", "50", "--limit", "20"], "--route: is missing; "),
        (["close", "0", "50", "--route", "up"], "--route up: not a route of "),
        (["close", "50", "0", "--route", "out"], "the stretch must end beyond its start"),
        (["switch-master", "--area", "9", "--to", "1", "--route", "out"], "--area 9: ferry-out"),
        (["line", "--web"], "--route: is missing; "),
        (["hold", "1", "--route", "up"], "--route up: not a route of "),
        (["line", "--line-radio", "tcp/192.0.2.1:7447"], "--line-radio tcp/192.0.2.1:7447"),
    ],
)
def test_what_does_not_fit_a_network_is_refused(
    words: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, "--service", SERVICE]) == EXIT_USAGE

    assert text in capsys.readouterr().err


def test_a_route_is_refused_on_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["hold", "1", "--route", "out"]) == EXIT_USAGE

    assert "hold: --route: only with --service" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("heard", "route", "said"),
    [
        ([], None, "nothing is received on short-out"),
        (["short-back"], None, "no train commands any path"),
        (["short-back"], 0, "nothing is received on short-out"),
        (["short-back"], 1, "no train commands any area of short-back"),
    ],
)
def test_without_a_train_that_commands_the_answer_says_what_is_received(
    heard: list[str],
    route: int | None,
    said: str,
    ways: list[Way],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    network = load_network(written(tmp_path, SHORT, SHORT_TRACKS))
    paths = [SupervisedPath(way.line.name[6:], way, divided(network, way)) for way in ways]
    radio, clock = Radio(), Instants()
    desk = NetworkDesk(paths, radio, clock, BENCH_KEY)  # type: ignore[arg-type]
    for name in heard:
        report = dataclasses.replace(REPORT, area=1)
        radio.waiting.append(RadioMessage(0, key_of(name, report), pack(report)))
    desk.listen(0.1)
    desks = desk.only(None if route is None else paths[route])

    code = show_network(Namespace(verb="line"), desks, clock)  # type: ignore[arg-type]

    assert code == EXIT_ENVIRONMENT
    assert capsys.readouterr().err == f"vobc: {said}\n"
