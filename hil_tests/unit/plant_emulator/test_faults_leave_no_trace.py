"""After the end of a fault the train behaves exactly like one that never had it."""

from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from can_dbc.doors import DoorCommand
from firmware_py.ports import RadioMessage
from firmware_py.settings import override
from firmware_py.trackdb import load_line
from firmware_py.trackdb.version import database_version
from plant_emulator.faults.declared_loops import LOOP_FAULTS
from plant_emulator.faults.kinds import CATALOGUE, FaultPlace
from plant_emulator.faults.plan import read_faults
from plant_emulator.train_config import TrainConfig, load_train
from plant_emulator.truth import SIGNALS
from plant_emulator.world import STEP_NS
from zenoh_config import codec, keys
from zenoh_config.messages import PositionReport, TrainStatus

pack = partial(codec.pack, database=database_version(load_line("florence")))


ATrain = Callable[..., Any]
TRAIN_PLACES = (
    *(FaultPlace.SENSOR, FaultPlace.ACTUATOR, FaultPlace.SUPPLY, FaultPlace.DOORS, FaultPlace.DESK),
    *(FaultPlace.WAYSIDE, FaultPlace.ALARMS),
)
KINDS = [kind.name for kind in CATALOGUE.values() if kind.place in TRAIN_PLACES]
LOOP_KINDS = [kind.name for kind in CATALOGUE.values() if kind.parameters in LOOP_FAULTS]
BUS_KINDS = [name for name in KINDS if name not in LOOP_KINDS]
LOOPED = override(
    load_train("florence4_loop"),
    {"loop.recovery_s": 3.0, "brake.service.dead_time_s": 0.5},
    "looped",
)
"""A shorted loop applies the brake, which would sample a dead time if it were not fixed."""
MILD = {"traction_runaway": {"accel_mps2": 0.2}, "tacho_interference": {"pulses_per_s": 0.0}}
"""A runaway this weak leaves the train standing under its holding brake. Pulses that interference
has added stay counted."""
OPEN = DoorCommand(enable_left=True, enable_right=True, open_left=True, open_right=True)
CLOSE = DoorCommand(enable_left=False, enable_right=False, open_left=False, open_right=False)


def program(train: Any) -> list[object]:
    """Everything that the train sends while it opens and closes doors, passes tags and brakes."""
    world, said = train.world, []
    last = world.tag_reader.last
    for duration_s, brake, traction, doors in (
        (4.0, train.HOLDING, train.FORBIDDEN, OPEN),
        (4.0, train.HOLDING, train.FORBIDDEN, CLOSE),
        (12.0, train.RELEASED, train.driving(150_000.0), CLOSE),
        (8.0, train.braking(0.7), train.FORBIDDEN, CLOSE),
        (12.0, train.EMERGENCY, train.FORBIDDEN, CLOSE),
    ):
        for step, _ in enumerate(train.each_step(duration_s, brake, traction, doors)):
            telegrams = world.tag_reader.telegrams(world.now_ns)
            if step % 5 == 0:
                speed_mps = world.consist.car_speeds_mps[0]
                said += [
                    world.tachos.frame(world.now_ns),
                    world.doppler.frame(speed_mps),
                    world.imu.frame(world.now_ns, speed_mps, world.consist.slope_mps2),
                    world.brake.status(),
                    world.traction.status(world.brake.electric_n),
                    world.doors.status(),
                    world.power.supply(),
                    world.desk,
                    world.alarms,
                    world.cold.frame(),
                    orders_to(train, world.now_ns),
                    world.tag_reader.frame(world.now_ns).antenna_ok,
                    world.tag_reader.last is last or world.tag_reader.last,
                    len(telegrams),
                    [getattr(train.truth, name) for name in SIGNALS if name != "tags_read"],
                ]
    return said


def orders_to(train: Any, now_ns: int) -> tuple[bytes, ...]:
    """The wayside's answer to a train's request, except for the count of resets."""
    status = TrainStatus(
        train=1, boot=1, sequence=now_ns // STEP_NS, stamp_ns=now_ns, mode=0, supervision=0,
        cause=0, localised=True, standstill=True, front_m=1500.0, doors_locked=True,
        open_left=False, open_right=False, passenger_alarm=False, fire=False, obstacle=False,
        alarm_raised=False,
    )  # fmt: skip
    report = PositionReport(1, 1, now_ns // STEP_NS, now_ns, 1499.0, 1501.0, 1430.0, 0.0, True)
    heard = [
        RadioMessage(now_ns, keys.status("florence", 1), pack(status)),
        RadioMessage(now_ns, keys.report("florence", 1), pack(report)),
    ]
    train.railway.centre.releases = 0
    return tuple(payload for _, payload in train.railway.answers(heard, now_ns))


def after(
    a_train: ATrain, *faults: dict[str, Any], consist: TrainConfig | None = None
) -> list[object]:
    """What the train sends from 12 s on, after standing until then."""
    train = a_train(*faults, train=consist or load_train("florence4"), front_m=1350.0)
    for _ in train.each_step(12.0, train.HOLDING, train.FORBIDDEN, CLOSE):
        train.world.tag_reader.telegrams(train.world.now_ns)
    begun = [fault for fault in faults if fault["start_s"] < 12.0]
    assert not train.schedule.active
    assert len(train.schedule.never_began) == len(faults) - len(begun)
    return program(train)


@pytest.fixture(scope="module")
def untouched() -> list[list[object]]:
    """The messages of a healthy train, computed once."""
    return []


def test_an_ended_fault_of_a_loop_leaves_no_trace(a_train: ATrain) -> None:
    untouched = after(a_train, consist=LOOPED)

    for kind in LOOP_KINDS:
        fault = {"kind": kind, "start_s": 2.0, "end_s": 4.0, "loop": "both"}
        assert after(a_train, fault, consist=LOOPED) == untouched, kind
    assert len(LOOP_KINDS) == 3


@pytest.mark.parametrize("kind", BUS_KINDS)
def test_an_ended_fault_leaves_no_trace(
    a_train: ATrain, untouched: list[list[object]], kind: str
) -> None:
    if not untouched:
        untouched.append(after(a_train))
    fault = {"kind": kind, "start_s": 2.0, "end_s": 4.0, **MILD.get(kind, {})}

    said = after(a_train, fault)

    assert said == untouched[0]


def test_faults_that_have_not_begun_change_nothing(
    a_train: ATrain, untouched: list[list[object]]
) -> None:
    if not untouched:
        untouched.append(after(a_train))

    assert after(a_train, *({"kind": k, "start_s": 1000.0} for k in BUS_KINDS)) == untouched[0]


def test_every_kind_of_the_train_has_an_effect(a_train: ATrain, looped: TrainConfig) -> None:
    """The faults occur one after the other on a running train; no assertion of the plant may
    fail."""
    faults = [{"kind": kind, "start_s": 0.5 * i, "duration_s": 1.0} for i, kind in enumerate(KINDS)]
    train = a_train(*faults, speed_mps=10.0, train=looped)
    train.run(0.5 * len(KINDS) + 2.0)

    assert len(KINDS) > 30
    assert not train.schedule.never_began
    assert [plan.kind.name for plan in read_faults(faults, "x")] == KINDS
