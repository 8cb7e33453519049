"""Invariant of temporary speed restrictions (4), from the orders that reach the controller."""

from metro_hil.monitors.context import Context
from metro_hil.monitors.gauge import Gauge
from metro_hil.monitors.place import LinePlaces
from plant_emulator.truth import Truth
from zenoh_config.messages import SpeedRestriction, TrainOrders

NS_PER_S = 1_000_000_000
ORDERS_AGE_NS = 5 * NS_PER_S
"""Age of orders that a train refuses on arrival."""


class RestrictionWatch:
    """Watches every restriction that the train has received, until newer orders lift it.

    A restriction may begin closer to the train than the train can brake. It is judged from the
    place on where the worst declared motion has reached its speed. That motion begins where the
    train received it.
    """

    __slots__ = (
        "_boot",
        "_build_up_s",
        "_decel_mps2",
        "_from_m",
        "_margin_mps",
        "_orders",
        "_place",
        "_reaction_s",
        "_runaway_mps2",
        "_runaway_s",
        "_sequence",
        "kept",
    )

    def __init__(self, context: Context, place: LinePlaces, *, kept: Gauge) -> None:
        self.kept = kept
        self._place = place
        self._margin_mps = context.emergency_margin_mps
        self._runaway_mps2 = context.runaway_mps2
        self._runaway_s = context.sensing_s + 2.0 * context.cycle_s + context.traction_cut_s
        self._build_up_s = context.build_up_s
        # Until the brake acts, a fault may delay cycles and frames. The brake unit ends that.
        self._reaction_s = 2.0 * context.cycle_s + context.slack_s + context.lateness_s
        self._reaction_s += context.takeover_s + self._runaway_s
        self._decel_mps2 = max(0.05, context.guaranteed_decel_mps2 - place.worst_fall_mps2)
        self._boot = self._sequence = -1
        self._orders: TrainOrders | None = None
        """Orders that were received since the last step."""
        self._from_m: dict[SpeedRestriction, float] = {}
        """Restrictions in force, each with the place of the front from which it is judged."""

    def heard(self, orders: TrainOrders) -> None:
        """Take sound orders as they reached the controller."""
        if orders.boot >= self._boot and orders.sequence > self._sequence:
            self._boot, self._sequence = orders.boot, orders.sequence
            self._orders = orders
            if not orders.restrictions:
                self._from_m, self._orders = {}, None

    @property
    def busy(self) -> bool:
        """There is a restriction, so the next step matters."""
        return self._orders is not None or bool(self._from_m)

    def sample(self, truth: Truth, now_ns: int, *, guaranteed: bool) -> None:
        """Take a step in which the train moves.

        Args:
            guaranteed: rail and brake give the rate that the braking distance assumes.
        """
        if self._orders is not None:
            self._take(self._orders, truth, now_ns)
        if not guaranteed:
            # Where the train cannot brake as declared, only later restrictions are judged.
            self._from_m = dict.fromkeys(self._from_m, float("inf"))
        front_m = truth.front_m
        for each, from_m in self._from_m.items():
            if front_m >= from_m and each.start_m <= front_m and truth.rear_m <= each.end_m:
                fall_mps2 = self._place.worst_fall_under_mps2(front_m)
                overshoot_mps = (self._runaway_mps2 + fall_mps2) * self._runaway_s
                most_mps = each.limit_mps + self._margin_mps + overshoot_mps
                most_mps += fall_mps2 * self._build_up_s
                self.kept.see(most_mps - abs(truth.speed_mps), now_ns)

    def _take(self, orders: TrainOrders, truth: Truth, now_ns: int) -> None:
        known, front_m = self._from_m, truth.front_m
        in_time = 0 <= now_ns - orders.echo_stamp_ns <= ORDERS_AGE_NS
        self._from_m = {
            each: known.get(each, front_m + self._braking_m(truth.speed_mps, each.limit_mps))
            for each in orders.restrictions
            if in_time or each in known
        }
        self._orders = None

    def _braking_m(self, speed_mps: float, limit_mps: float) -> float:
        """Distance in which the worst declared motion gets down to the limit."""
        fall_mps2 = self._place.worst_fall_mps2
        time_s = self._reaction_s + self._build_up_s
        reached_mps = abs(speed_mps) + self._runaway_mps2 * self._reaction_s + fall_mps2 * time_s
        braked_m = (reached_mps * reached_mps - limit_mps * limit_mps) / (2.0 * self._decel_mps2)
        return reached_mps * time_s + max(0.0, braked_m)
