"""Faults in the closed loop: they act, they disturb nothing else, and runs stay reproducible."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest

from metro_hil.model.frame_hash import FrameHash
from metro_hil.model.mission import plan_journey
from metro_hil.model.run_options import parse
from metro_hil.run.lockstep import Lockstep, Taps, config_of, scenario_of
from plant_emulator.faults.declared_loops import LOOP_FAULTS
from plant_emulator.faults.kinds import CATALOGUE, FaultPlace
from plant_emulator.faults.plan import FaultPlan, read_faults
from plant_emulator.truth import SIGNALS, Truth

END_S = 25.0
ARGUMENTS = ("run", "--lockstep", "--from", "II", "--to", "III")
PLANT_KINDS = [
    kind.name
    for kind in CATALOGUE.values()
    if kind.place not in (FaultPlace.BUS, FaultPlace.PROCESS) and kind.parameters not in LOOP_FAULTS
]
LOOP_KINDS = [kind.name for kind in CATALOGUE.values() if kind.parameters in LOOP_FAULTS]
LOOPED = (*ARGUMENTS, "--consist", "florence4_loop", "--output", "current_loop")


@dataclass
class Run:
    chain: str = ""
    samples: list[dict[str, float]] = field(default_factory=list)
    instants_ns: list[int] = field(default_factory=list)
    changes: list[tuple[str, bool, float]] = field(default_factory=list)
    bench: Lockstep | None = None

    def at(self, t_s: float) -> dict[str, float]:
        return self.samples[round(t_s * 100)]


def run(
    *faults: dict[str, Any],
    seed: int = 3,
    watched: bool = True,
    duration_s: float = END_S,
    arguments: Sequence[str] = ARGUMENTS,
) -> Run:
    found, chain = Run(), FrameHash()

    def observe(truth: Truth, now_ns: int) -> None:
        found.samples.append({name: getattr(truth, name) for name in SIGNALS})
        found.instants_ns.append(now_ns)

    def change(plan: FaultPlan, active: bool, now_ns: int) -> None:
        found.changes.append((plan.kind.name, active, now_ns / 1e9))

    options = parse([*arguments, "--seed", str(seed)])
    plans: Sequence[FaultPlan] = read_faults(faults, "scenario")
    bench = Lockstep(
        config_of(options),
        scenario_of(options),
        plan_journey(options),
        faults=plans,
        taps=Taps(frame=chain.frame, truth=observe if watched else None),
    )
    bench.plant.schedule.listen(change)
    bench.run(duration_s)
    bench.close()
    found.chain, found.bench = chain.value, bench
    return found


@pytest.fixture(scope="module")
def healthy() -> Run:
    return run()


def test_the_truth_is_reported_at_the_start_and_after_every_step(healthy: Run) -> None:
    assert healthy.instants_ns == [10_000_000 * step for step in range(round(END_S * 100))]
    assert [sample["t_s"] for sample in healthy.samples[:3]] == [0.0, 0.01, 0.02]
    assert healthy.samples[-1]["front_m"] > healthy.samples[0]["front_m"] + 50.0


def test_without_an_authority_its_end_is_the_trains_front(healthy: Run) -> None:
    assert healthy.samples[0]["authority_end_m"] == healthy.samples[0]["front_m"]
    assert healthy.bench is not None
    assert healthy.samples[-1]["authority_end_m"] == healthy.bench.plant.zone.end_m


def test_an_observer_does_not_change_a_run(healthy: Run) -> None:
    assert run(watched=False).chain == healthy.chain


def test_faults_after_the_end_change_no_frame(healthy: Run) -> None:
    """All kinds that the plant causes are scheduled at once."""
    late = run(*({"kind": kind, "start_s": END_S + 1.0} for kind in PLANT_KINDS))
    assert late.chain == healthy.chain
    assert late.changes == []


def test_the_same_faults_give_the_same_frames_and_other_seeds_others() -> None:
    faults = [
        {"kind": kind, "start_s": 5.0 + 0.5 * index, "duration_s": 0.4}
        for index, kind in enumerate(PLANT_KINDS)
    ]
    one, again, other = run(*faults), run(*faults), run(*faults, seed=4)
    assert one.chain == again.chain
    assert one.samples == again.samples
    assert one.changes == again.changes
    assert one.chain != other.chain
    assert len(one.changes) > 50


def test_faults_of_loops_give_the_same_frames_and_none_before_they_begin() -> None:
    late = ({"kind": kind, "start_s": END_S + 1.0} for kind in LOOP_KINDS)
    faults = [{"kind": kind, "start_s": 8.0, "duration_s": 2.0} for kind in LOOP_KINDS]
    healthy, untouched = run(arguments=LOOPED), run(*late, arguments=LOOPED)
    one, again = (run(*faults, arguments=LOOPED) for _ in range(2))

    assert untouched.chain == healthy.chain
    assert one.chain == again.chain != healthy.chain
    assert len(one.changes) == 6


def test_a_fault_begins_with_the_frames_of_its_instant_and_is_reported_then() -> None:
    struck = run({"kind": "passenger_alarm", "start_s": 20.0, "end_s": 20.5})
    assert struck.changes == [("passenger_alarm", True, 20.0), ("passenger_alarm", False, 20.5)]


def test_faults_of_bus_and_process_are_only_reported(healthy: Run) -> None:
    """The plant alone does not cause these faults."""
    struck = run({"kind": "clock_step", "step_s": 0.0, "when": "speed_mps > 3", "end_s": 24.0})
    ((_, began, at_s), (_, ended, end_s)) = struck.changes
    assert (began, ended, end_s) == (True, False, 24.0)
    assert healthy.at(at_s)["speed_mps"] > 3.0 >= healthy.at(at_s - 0.01)["speed_mps"]
    assert struck.samples == healthy.samples


def test_a_runaway_is_stopped_by_protection() -> None:
    """Acceptance: the emergency brake at 8 km/h above the limit, and traction cut within 0.3 s."""
    fault = {"kind": "traction_runaway", "when": "speed_mps > 16", "accel_mps2": 1.0}
    struck = run(fault, duration_s=60.0)
    began_s = struck.changes[0][2]
    later = [each for each in struck.samples if each["t_s"] > began_s]
    tripped_s = next(each["t_s"] for each in later if each["emergency"])

    assert max(each["speed_mps"] - each["civil_limit_mps"] for each in later) < 8.0 / 3.6 + 0.5
    assert struck.at(tripped_s + 0.31)["drive_n"] == 0.0
    assert struck.at(tripped_s + 0.31)["traction_cut"] == 1.0
    assert struck.samples[-1]["speed_mps"] == 0.0


def test_a_lost_supply_cuts_effort(healthy: Run) -> None:
    dark = run({"kind": "line_voltage", "voltage_v": 0.0, "start_s": 10.0, "end_s": 20.0})
    assert healthy.at(19.0)["drive_n"] != 0.0 or healthy.at(12.0)["drive_n"] != 0.0
    assert {dark.at(t_s)["drive_n"] for t_s in (10.5, 15.0, 19.9)} == {0.0}
    assert {dark.at(t_s)["voltage_v"] for t_s in (10.5, 15.0, 19.9)} == {0.0}


def test_without_radio_there_is_no_authority_and_no_motion() -> None:
    struck = run({"kind": "radio_partition"})
    assert struck.samples[-1]["authority_end_m"] == struck.samples[0]["front_m"]
    assert struck.samples[-1]["front_m"] == struck.samples[0]["front_m"]


def test_without_the_serial_line_tags_are_read_but_not_received(healthy: Run) -> None:
    struck = run({"kind": "serial_cut"})
    assert struck.bench is not None
    assert struck.bench.plant.world.tag_reader.tags_read > 0
    assert struck.chain != healthy.chain
