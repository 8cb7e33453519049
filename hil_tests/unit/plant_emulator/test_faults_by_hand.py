"""Acts of a person on faults and desk: a replay of their record is the same at each step."""

import json
import random
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from can_dbc.cab import CabMode, Desk
from firmware_py.storage.growing_file import GrowingFile
from plant_emulator.desk.attendant import attendant
from plant_emulator.desk.by_keys import keyed
from plant_emulator.desk.display import DeskDisplay
from plant_emulator.desk.hands import KEYS
from plant_emulator.desk.recording import parse_recording
from plant_emulator.faults.by_hand import ActError, FaultsByHand, plan_by_hand
from plant_emulator.faults.fitting import FaultTargets
from plant_emulator.faults.kinds import BENCH_PLACES, FaultPlace
from plant_emulator.faults.plan import FaultPlan, read_faults
from plant_emulator.faults.schedule import Schedule
from plant_emulator.train_config import load_train
from plant_emulator.truth import Truth

TARGETS = FaultTargets(load_train("florence4"))
EVERYWHERE = frozenset(FaultPlace)
STEP_NS = 10_000_000
Changes = list[tuple[int, int, bool, Any]]


def changes_of(schedule: Schedule, steps: int, by_hand: FaultsByHand | None = None) -> Changes:
    """Run a schedule and return step, index, activity and parameters of each change."""
    found: Changes = []

    def note(plan: FaultPlan, active: bool, now_ns: int) -> None:
        found.append((now_ns // STEP_NS, plan.index, active, plan.parameters))

    schedule.listen(note)
    truth = Truth()
    for step in range(steps):
        truth.t_s = step * STEP_NS / 1e9
        if by_hand is not None:
            by_hand.step(truth.t_s, schedule)
        schedule.step(truth, step * STEP_NS)
    return found


class ScriptedActs:
    """Acts by step of the plant."""

    def __init__(self, acts: Mapping[int, Sequence[object]]) -> None:
        self._acts, self._step = acts, -1

    def lines(self) -> Sequence[str]:
        self._step += 1
        return [
            each if isinstance(each, str) else json.dumps(each)
            for each in self._acts.get(self._step, ())
        ]


def run(
    acts: Mapping[int, Sequence[object]], steps: int
) -> tuple[Changes, list[dict[str, Any]], str]:
    texts: list[str] = []
    by_hand = FaultsByHand(ScriptedActs(acts).lines, texts.append, TARGETS, EVERYWHERE)
    found = changes_of(Schedule(()), steps, by_hand)
    text = texts[-1] if texts else ""
    return found, tomllib.loads(text).get("fault", []), text


def weak(ratio: float) -> dict[str, Any]:
    return {"kind": "brake_weak", "gain_ratio": ratio}


def test_a_fault_is_started_set_and_stopped_at_the_step_of_the_act() -> None:
    acts: dict[int, Sequence[object]] = {
        3: [{"start": weak(0.5)}],
        7: [{"set": 0, "values": {"gain_ratio": 0.25}}],
        9: [{"stop": 1}],
    }
    found, tables, text = run(acts, 12)

    told = [(step, index, active, each.gain_ratio) for step, index, active, each in found]
    assert told == [(3, 0, True, 0.5), (7, 0, False, 0.5), (7, 1, True, 0.25), (9, 1, False, 0.25)]
    assert tables == [
        {"kind": "brake_weak", "start_s": 0.03, "end_s": 0.07, "gain_ratio": 0.5},
        {"kind": "brake_weak", "start_s": 0.07, "end_s": 0.09, "gain_ratio": 0.25},
    ]
    assert text.startswith("# Faults that a person started")


def test_a_fault_that_is_stopped_in_its_first_step_acts_for_one_step() -> None:
    found, tables, _ = run({2: [{"start": weak(0.5)}, {"stop": 0}]}, 5)

    assert [(step, active) for step, _, active, _ in found] == [(2, True), (3, False)]
    assert (tables[0]["start_s"], tables[0]["end_s"]) == (0.02, 0.03)


@pytest.mark.parametrize("seed", range(6))
def test_the_record_replays_random_acts_at_the_same_steps(seed: int) -> None:
    chance = random.Random(seed)
    acts: dict[int, list[object]] = {}
    for _ in range(60):
        index = chance.randrange(12)
        act = chance.choice(
            (
                {"start": weak(chance.random())},
                {"start": {"kind": "passenger_alarm"}},
                {"stop": index},
                {"set": index, "values": {"gain_ratio": chance.random()}},
                {"set": index, "values": {}},
            )
        )
        acts.setdefault(chance.randrange(200), []).append(act)

    found, tables, _ = run(acts, 220)
    again = changes_of(Schedule(read_faults(tables, "record")), 220)

    assert len(found) > 20
    assert again == found


@pytest.mark.parametrize(
    "act",
    [
        "{",
        "3",
        '"start"',
        {"start": 3},
        {"start": {"kind": "nonsense"}},
        {"start": {"kind": "brake_weak", "gain_ratio": 3.0}},
        {"start": {"kind": "brake_weak", "start_s": 3.0}},
        {"start": {"kind": "loop_break"}},
        {"stop": 0},
        {"stop": [1]},
        {"set": 0, "values": {}},
        {"set": 0},
    ],
)
def test_an_impossible_act_changes_nothing(act: object) -> None:
    found, tables, _ = run({1: [act, {"start": weak(0.5)}]}, 4)

    assert [(step, index) for step, index, _, _ in found] == [(1, 0)]
    assert [each["kind"] for each in tables] == ["brake_weak"]


@pytest.mark.parametrize(
    ("table", "places", "text"),
    [
        ({"kind": "brake_wek"}, EVERYWHERE, "nearest valid kind: brake_weak"),
        (weak(3.0), EVERYWHERE, "gain_ratio 3 is not within 0..2"),
        ({"kind": "brake_weak", "gain": 1.0}, EVERYWHERE, "gain"),
        ({"kind": "brake_weak", "when": "t_s > 3"}, EVERYWHERE, "when: the fault begins at once"),
        ({"kind": "loop_break"}, EVERYWHERE, "no current loops"),
        ({"kind": "frame_drop"}, EVERYWHERE - BENCH_PLACES, "acts on the bus, which a run in real"),
        (["brake_weak"], EVERYWHERE, "no table of a fault"),
    ],
)
def test_a_refusal_says_why(table: Any, places: frozenset[FaultPlace], text: str) -> None:
    with pytest.raises(ActError) as refusal:
        plan_by_hand(table, 4, TARGETS, places)

    assert text in str(refusal.value)
    assert "fault[" not in str(refusal.value)


@pytest.mark.parametrize("seed", range(3))
def test_the_recording_of_a_keyed_desk_replays_each_frame(seed: int) -> None:
    chance, waiting, lines = random.Random(seed), list[str](), list[str]()
    names = [name for name, _, _ in KEYS]
    start_ns, display = 7 * STEP_NS, DeskDisplay()

    def pressed() -> list[str]:
        taken = waiting.copy()
        waiting.clear()
        return taken

    drive = keyed(pressed, lines.append, mode=CabMode.MANUAL, start_ns=start_ns)
    instants = range(start_ns + 7 * STEP_NS, start_ns + 3000 * STEP_NS, 10 * STEP_NS)
    frames: list[Desk] = []
    for now_ns in instants:
        waiting += chance.choices(names, k=chance.choice((0, 0, 0, 1, 2)))
        frames.append(drive(display, now_ns))

    recording = parse_recording("".join(lines), "run.desk")
    replay = attendant(None, recording, mode=CabMode.AUTO, start_ns=start_ns)
    assert replay is not None
    assert [replay(display, now_ns) for now_ns in instants] == frames
    assert len(lines) > 50


def test_a_growing_file_gives_whole_lines_once(tmp_path: Path) -> None:
    path = tmp_path / "acts"
    file = GrowingFile(path)
    found = [file.lines()]
    for text in (b"one\ntw", b"o\n\xff\n", b"", b"three"):
        with path.open("ab") as end:
            end.write(text)
        found.append(file.lines())
    file.close()

    assert [list(each) for each in found] == [[], ["one"], ["two", "\ufffd"], [], []]
