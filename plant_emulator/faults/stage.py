"""Applies the faults of one plant at each step: reads the truth, updates the faults, notifies the
observer.
"""

from collections import Counter
from collections.abc import Callable

from plant_emulator.faults.by_hand import FaultsByHand
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
from plant_emulator.truth import NO_SWITCH_M, Truth
from plant_emulator.wayside.railway import Railway
from plant_emulator.world import World

Observer = Callable[[Truth, int], None]
"""Callback with the truth at an instant of the plant's clock. The same object is refilled each
time."""


class FaultStage:
    """Evaluates the faults once before the plant's first step and after each step.

    The order is: read the truth; apply what a person did; let the schedule end and begin faults in
    the order of the scenario, which notifies first the effects, then the other listeners; step the
    active effects in the order of the scenario; notify the observer. Frames and telegrams of that
    instant leave afterwards. The train then moves on under the active faults.
    """

    def __init__(
        self,
        world: World,
        schedule: Schedule,
        *,
        start_ns: int,
        observer: Observer | None,
        railway: Railway,
        by_hand: FaultsByHand | None = None,
    ) -> None:
        """Args:
        by_hand: what a person does to the faults while the train runs.
        """
        self.truth = Truth()
        self.began = False
        """Whether `look` has been called before."""
        self._world, self._schedule, self._railway = world, schedule, railway
        self._start_m = world.front_m
        self._railway_changes = -1
        """Counter of wayside news up to which the truth is current."""
        self._start_ns, self._observer, self._by_hand = start_ns, observer, by_hand
        self._effects: dict[int, Effect] = {}
        """Effects of all faults that have begun so far, by the fault's index."""
        self._acting: list[tuple[int, Effect]] = []
        """Effects that need a call at every step, in the order of the scenario."""
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
        """For each active fault, by index, the check whether it changed anything in the last
        step."""
        self._touched: Counter[int] = Counter()
        schedule.listen(self._change)

    def look(self, authority_end_m: float) -> None:
        """Evaluate the faults on the present state of the world."""
        self.began = True
        truth, now_ns, told = self.truth, self._world.now_ns, self._railway.told
        if told != self._railway_changes:
            self._railway_changes = told
            truth.hear(self._railway, self._start_m)
        truth.read(self._world, self._start_ns, authority_end_m)
        if self._railway.interlocking is not None:
            truth.unlocked_switch_m = min(self._railway.interlocking.unlocked_m, NO_SWITCH_M)
        for index, touch in self._touches.items():
            self._touched[index] += touch()
        if self._by_hand is not None:
            self._by_hand.step(truth.t_s, self._schedule)
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
        """Number of steps, or of tag readings, that each fault has changed, by the fault's
        index.
        """
        counted = {
            index: effect.touched
            for index, effect in self._effects.items()
            if isinstance(effect, Counting)
        }
        return Counter({**self._touched, **counted})

    def _effect_of(self, plan: FaultPlan) -> Effect | None:
        """Return the same effect each time the fault begins again; None for faults that the plant
        does not apply.
        """
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
