"""The observer of trains on a network judges them by the places that they report."""

from pathlib import Path

import msgspec
import pytest

from firmware_py.ports import RadioMessage
from firmware_py.trackdb.circuit import load_path
from hil_tests.unit.metro_hil.line.test_turning_masters import SHORT, SHORT_TRACKS, written
from metro_hil.cli.hil import main
from metro_hil.line.turning.invariants import INTO_AUTHORITY, INTO_TRAIN, OVERLAP, PairViolation
from metro_hil.line.turning.network_verdict import show
from metro_hil.line.turning.train import ProtectionBrake, TripRecord
from metro_hil.line.turning.witness import NetworkWitness
from metro_hil.metrics.stops import StationStop
from metro_hil.model.run_folder import plain
from metro_hil.model.run_options import EXIT_USAGE
from plant_emulator.wayside.network_places import TrainPlace, TrainPresence, key_of_place

OUT = TrainPlace(TrainPresence.PRESENT, 0, "short-out", 60.0, 30.0, 60.0, 350.0, (), 0.0, 10.0)
SERVICE = "docs/examples/line/shuttle.toml"


@pytest.fixture
def witness(tmp_path: Path) -> NetworkWitness:
    file = written(tmp_path, SHORT, SHORT_TRACKS)
    return NetworkWitness([load_path(f"{file}:out"), load_path(f"{file}:back")])


def tell(witness: NetworkWitness, train: int, **changes: object) -> None:
    place = msgspec.structs.replace(OUT, **changes)
    payload = msgspec.json.encode(place)
    witness.on_message(RadioMessage(0, key_of_place("short", train), payload))


def kinds(witness: NetworkWitness) -> list[str]:
    return [each.kind for each in witness.violations]


def test_trains_that_keep_apart_are_checked_and_their_least_gap_is_known(
    witness: NetworkWitness,
) -> None:
    tell(witness, 1, front_m=200.0, rear_m=170.0, end_m=300.0)
    tell(witness, 2, end_m=169.9)

    assert kinds(witness) == []
    assert witness.checked_count == 1
    assert witness.least_gap_m == pytest.approx(110.0)


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        ({"end_m": 170.1}, INTO_TRAIN),
        ({"front_m": 175.0, "end_m": 175.0}, OVERLAP),
        # The path back runs over the same siding at the end, from 0 m on.
        (
            {"path": "short-back", "front_m": 40.0, "rear_m": 10.0, "end_m": 60.0},
            INTO_AUTHORITY,
        ),
    ],
)
def test_a_train_or_authority_in_the_way_of_another_is_a_violation(
    witness: NetworkWitness, change: dict[str, object], kind: str
) -> None:
    tell(witness, 1, front_m=200.0, rear_m=170.0, end_m=320.0)
    tell(witness, 2, **change)
    tell(witness, 2, **change)

    assert kinds(witness) == [kind]
    assert {*witness.violations[0].trains} == {"train 1", "train 2"}


def test_places_of_different_instants_prove_nothing(witness: NetworkWitness) -> None:
    tell(witness, 1, front_m=200.0, rear_m=170.0)
    tell(witness, 2, end_m=250.0, at_s=11.1)

    assert (witness.checked_count, witness.skewed_count, kinds(witness)) == (0, 1, [])


def test_a_train_that_is_gone_is_in_no_ones_way(witness: NetworkWitness) -> None:
    tell(witness, 1, front_m=200.0, rear_m=170.0)
    tell(witness, 1, presence=TrainPresence.GONE)
    tell(witness, 2, end_m=250.0)

    assert (witness.gone, kinds(witness), witness.checked_count) == ({1}, [], 0)


def test_the_verdict_counts_only_what_happened(capsys: pytest.CaptureFixture[str]) -> None:
    stop = StationStop("Pier", 0.012, 50.0, 45.0, 0)
    record = TripRecord(1, 0, "Mill", "Pier", 0.0, None, turned=False, ended_s=60.0, stops=[stop])
    missed = [StationStop("Mill", None, None, None, 0)]
    under_way = TripRecord(1, 1, "Pier", "Mill", 60.0, None, turned=True, stops=missed)
    violation = PairViolation(INTO_TRAIN, 12.5, ("train 1", "train 2"))
    brake = ProtectionBrake(13.0, 1, "service", "authority_old")

    show(
        {
            "exit_reason": "duration over",
            "least_gap_m": None,
            "checked_count": 7,
            "violations": [plain(violation)],
            "protection_brakes": [{**plain(brake), "is_explained": False}],
            "strikes": [],
            "takeovers": [],
            "trips": [plain(record), plain(under_way)],
            "doubts": ["the observer lost 3 messages"],
        }
    )

    assert capsys.readouterr().out.splitlines() == [
        "duration over: 1 trips, 1 changes of ends, worst stop error 1.2 cm",
        "7 checks of two trains, 1 violations, 1 brakes by protection",
        f"at 12.50 s, train 1 and train 2: {INTO_TRAIN}",
        "at 13.00 s, train 1: service brake, authority old",
        "invalid: the observer lost 3 messages",
    ]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--restart-train-at", "T1@3"], "--restart-train-at: not with --service"),
        (["--kill-master-at", "95"], "--kill-master-at 95: the run ends before, by --for 90"),
        (["--line", "loop"], "--line: not with --service"),
        (["--watch"], "--watch: not with --service"),
        (["--loss", "0.1"], "--networks: not with --service"),
        (["--topology", "mesh"], "--topology: not with --service"),
        (["--bench", "lockstep"], "in virtual time `vobc run --lockstep --service FILE --masters`"),
    ],
)
def test_options_that_do_not_fit_trains_of_a_service_are_refused(
    words: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "line", "--service", SERVICE, *words]) == EXIT_USAGE

    assert text in capsys.readouterr().err
