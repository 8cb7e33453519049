"""The faults of one plant at work: what is true, which of them act now, and who is told."""

from collections import Counter
from collections.abc import Callable

from plant_emulator.faults.effects import Counting, Effect
from plant_emulator.faults.effects_actuator import ActuatorEffects
from plant_emulator.faults.effects_alarms import AlarmEffects
from plant_emulator.faults.effects_desk import DeskEffects
from plant_emulator.faults.effects_doors import DoorEffects
from plant_emulator.faults.effects_sensor import SensorEffects
from plant_emulator.faults.effects_supply import SupplyEffects
from plant_emulator.faults.effects_tags import TagEffects
from plant_emulator.faults.effects_wayside import WaysideEffects
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.faults.schedule import Schedule
from plant_emulator.faults.touches import Touch, touch_of
from plant_emulator.truth import Truth
from plant_emulator.wayside.railway import Railway
from plant_emulator.world import World

Observer = Callable[[Truth, int], None]
"""Is told what is true at an instant of the plant's clock. The truth is one object, filled anew."""


class FaultStage:
    """Looked at once before the first step of the plant and after each.

    In this order: the truth is read; the schedule tells of every fault that ends or begins, in the
    order of the scenario, first the effects, then whoever else listens; the effects that act are
    told of the step, in the order of the scenario; the observer is told. Frames and telegrams of
    that instant leave afterwards, and the train moves on under what acts then.
    """

    def __init__(
        self,
        world: World,
        schedule: Schedule,
        *,
        start_ns: int,
        observer: Observer | None,
        railway: Railway,
    ) -> None:
        self.truth = Truth()
        self.began = False
        """Whether there was a first look."""
        self._world, self._schedule, self._railway = world, schedule, railway
        self._start_m = world.front_m
        self._told = -1
        """What of the wayside's news the truth knows."""
        self._start_ns, self._observer = start_ns, observer
        self._effects: dict[int, Effect] = {}
        """By index of the fault, of all that began so far."""
        self._acting: list[tuple[int, Effect]] = []
        """Those that want to be told of steps, in the order of the scenario."""
        self._actuators = ActuatorEffects(world)
        self._sensors = SensorEffects(world)
        self._tags = TagEffects(world)
        self._supply = SupplyEffects(world)
        self._doors = DoorEffects(world)
        self._desk = DeskEffects(world)
        self._alarms = AlarmEffects(world)
        self._wayside = WaysideEffects(railway)
        self._active: set[int] = set()
        self._touches: dict[int, Touch] = {}
        """By index of each fault that acts: whether the last step was another for it."""
        self._touched: Counter[int] = Counter()
        schedule.listen(self._change)

    def look(self, authority_end_m: float) -> None:
        """At the world as it is now."""
        self.began = True
        truth, now_ns, told = self.truth, self._world.now_ns, self._railway.told
        if told != self._told:
            self._told = told
            truth.hear(self._railway, self._start_m)
        truth.read(self._world, self._start_ns, authority_end_m)
        for index, touch in self._touches.items():
            self._touched[index] += touch()
        self._schedule.step(truth, now_ns)
        if self._acting:
            self._acting = [
                (index, effect)
                for index, effect in self._acting
                if effect.step(now_ns) or index in self._active
            ]
        if self._observer is not None:
            self._observer(truth, now_ns)

    def _change(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        effect = self._effect_of(plan)
        if effect is None:
            return
        if active:
            self._active.add(plan.index)
            self._touched.setdefault(plan.index, 0)
            self._touches[plan.index] = touch_of(plan, self._world, self._railway)
            effect.begin(now_ns)
            others = [each for each in self._acting if each[0] != plan.index]
            self._acting = sorted([*others, (plan.index, effect)], key=lambda each: each[0])
        else:
            self._active.discard(plan.index)
            self._touches.pop(plan.index, None)
            effect.end(now_ns)

    @property
    def touched(self) -> Counter[int]:
        """By index of the fault: how many steps, or readings of tags, it changed so far."""
        counted = {
            index: effect.touched
            for index, effect in self._effects.items()
            if isinstance(effect, Counting)
        }
        return Counter({**self._touched, **counted})

    def _effect_of(self, plan: FaultPlan) -> Effect | None:
        """The same each time a fault begins again; None where the plant brings nothing about."""
        effect = self._effects.get(plan.index)
        if effect is None:
            effect = self._make(plan)
            if effect is not None:
                self._effects[plan.index] = effect
        return effect

    def _make(self, plan: FaultPlan) -> Effect | None:
        place = plan.kind.place
        if place is FaultPlace.SENSOR:
            effect = self._sensors.of(plan) or self._tags.of(plan) or self._alarms.of(plan)
            assert effect is not None, f"{plan.kind.name} has no effect"
            return effect
        if place is FaultPlace.ACTUATOR:
            return self._actuators.of(plan)
        if place is FaultPlace.SUPPLY:
            return self._supply.of(plan)
        if place is FaultPlace.DOORS:
            return self._doors.of(plan)
        if place is FaultPlace.DESK:
            return self._desk.of(plan)
        if place is FaultPlace.ALARMS:
            return self._alarms.of(plan)
        if place is FaultPlace.WAYSIDE:
            return self._wayside.of(plan)
        return None
