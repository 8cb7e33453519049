"""High-voltage box: line voltage under the train's own current, and the energy meter.

The line is one source behind a resistance that also takes back whatever the train returns. While it
does not, the auxiliaries take what the motors brake, and a brake resistor the rest.
"""

from math import exp, inf, sqrt
from typing import Final, NamedTuple

from can_dbc.energy import EnergyMeter, LineSupply
from plant_emulator.train_config import SupplyConfig

J_PER_KWH: Final = 3.6e6
COLD_J: Final = 1.0e3
"""A resistor with less heat in it is cold."""
RECEPTIVE_RATIO: Final = 1.2
"""A line takes current back up to this share of its no-load voltage; EN 50163 allows as much."""

RECOVERS_RATIO: Final = 0.1
"""So much of the effort at most comes back with each answer of the network: a train that took all
at once would pull the voltage down again."""

LEAST_EFFORT_RATIO: Final = 0.05
"""A train that fades away counts as wishing at most so many times what it takes."""


class Due(NamedTuple):
    """Of steps that the network has not answered yet, in J."""

    wished_j: float = 0.0
    """Of traction, at full voltage."""
    pulled_j: float = 0.0
    braked_j: float = 0.0
    auxiliary_j: float = 0.0


class Wish(NamedTuple):
    """Mean powers of a train since it was asked last, as it would have them at full voltage."""

    traction_w: float
    regenerated_w: float
    auxiliary_w: float


class HighVoltageBox:
    """Books in joules; drawn - returned = traction - braking + auxiliary + resistor at any time."""

    __slots__ = (
        "_auxiliary_w",
        "_braked_j",
        "_config",
        "_cool_ratio",
        "_electric_ratio",
        "_no_load_v",
        "_on_network",
        "_pulled_j",
        "_rest_j",
        "_resting",
        "_step_s",
        "_traction_ratio",
        "_wished_j",
        "auxiliary_j",
        "braking_j",
        "breaker_closed",
        "current_a",
        "drawn_j",
        "effort_ratio",
        "electric_limit_w",
        "heat_j",
        "live",
        "networked",
        "receptive",
        "resistor_j",
        "returned_j",
        "traction_j",
        "voltage_v",
    )

    def __init__(
        self,
        config: SupplyConfig,
        *,
        step_s: float,
        traction_efficiency_ratio: float,
        electric_efficiency_ratio: float,
    ) -> None:
        self._config = config
        self._step_s = step_s
        self._traction_ratio = traction_efficiency_ratio
        self._electric_ratio = electric_efficiency_ratio
        self.voltage_v = config.no_load_v
        self.current_a = 0.0
        """Negative while the train feeds back."""
        self.effort_ratio = 1.0
        """Share of traction's effort that the voltage leaves."""
        self.traction_j = 0.0
        """Electrical, into the inverters."""
        self.braking_j = 0.0
        """Electrical, out of the inverters while the motors brake."""
        self.auxiliary_j = 0.0
        self.drawn_j = 0.0
        self.returned_j = 0.0
        self.resistor_j = 0.0
        """What the brake resistor was given since the start."""
        self.heat_j = 0.0
        """What it has not given to the air yet."""
        resistor = config.resistor
        self._cool_ratio = 1.0 if resistor is None else exp(-step_s / resistor.cool_s)
        self.electric_limit_w = inf
        """At the rail: what the electric brake may take from the train now; 0 is none at all."""
        self._resting = False
        self._on_network = False
        self.networked = False
        """The network of a line feeds the train, as long as no fault puts another source there."""
        self._wished_j = self._pulled_j = self._braked_j = self._rest_j = 0.0
        """What is due and was not asked for yet, as in `Due`."""
        self._no_load_v = config.no_load_v
        self._auxiliary_w = config.auxiliary_w
        self.breaker_closed = True
        self.live = True
        """The line feeds the train."""
        self.receptive = True
        """The line takes back what the motors brake."""

    def connect(self, no_load_v: float | None, *, breaker_closed: bool) -> None:
        """A fault: another source behind the line, or the main breaker open; None is the own one.

        A source too weak for any effort feeds nothing, auxiliaries included: they live on the
        battery, which is not metered. One far above its rating takes nothing back; what the motors
        brake goes into the resistor then. On a network only the breaker counts, and a source that
        is given takes the train off it.
        """
        config = self._config
        self._on_network = self.networked and no_load_v is None
        self._no_load_v = config.no_load_v if no_load_v is None else no_load_v
        self.breaker_closed = breaker_closed
        self.live = breaker_closed and self._no_load_v > config.no_effort_v
        self.receptive = self.live and self._no_load_v <= RECEPTIVE_RATIO * config.no_load_v
        self._auxiliary_w = config.auxiliary_w if self.live else 0.0
        self._resting = not self.live
        if not self.live:
            self.voltage_v, self.current_a, self.effort_ratio = self._no_load_v, 0.0, 0.0
        elif not self._on_network:
            self._load_line(self._auxiliary_w * self._step_s)
        self._limit_electric()

    def _limit_electric(self) -> None:
        resistor = self._config.resistor
        if not self.live or (resistor is None and not self.receptive):
            self.electric_limit_w = 0.0
        elif resistor is None or self.receptive or self._electric_ratio == 0.0:
            self.electric_limit_w = inf
        else:
            left_j = resistor.heat_max_j - self.heat_j
            borne_w = max(0.0, min(resistor.max_power_w, left_j / resistor.fade_s))
            self.electric_limit_w = (self._auxiliary_w + borne_w) / self._electric_ratio

    def _cool(self) -> None:
        self.heat_j *= self._cool_ratio
        if self.heat_j < COLD_J:
            self.heat_j = 0.0
        if not self.receptive:
            self._limit_electric()

    def rest(self) -> None:
        """Book one step in which the motors do nothing."""
        if not self._resting:
            self.step(0.0, 0.0)
            self._resting = True
            return
        auxiliary_j = self._auxiliary_w * self._step_s
        self.auxiliary_j += auxiliary_j
        if self._on_network:
            self._owe(0.0, 0.0, auxiliary_j)
        else:
            self.drawn_j += auxiliary_j
        if self.heat_j > 0.0:
            self._cool()

    def step(self, drive_work_j: float, brake_work_j: float) -> None:
        """Book one step.

        Args:
            drive_work_j: done at the rail by tractive effort; negative when the train rolls against
                it, and then it brakes.
            brake_work_j: taken at the rail by the electric brake; never negative.
        """
        step_s = self._step_s
        self._resting = False
        if drive_work_j < 0.0:
            drive_work_j, brake_work_j = 0.0, brake_work_j - drive_work_j
        traction_j = drive_work_j / self._traction_ratio
        braking_j = brake_work_j * self._electric_ratio
        auxiliary_j = self._auxiliary_w * step_s
        net_j = traction_j - braking_j + auxiliary_j
        self.traction_j += traction_j
        self.braking_j += braking_j
        self.auxiliary_j += auxiliary_j
        if self._on_network:
            self._owe(traction_j, braking_j, auxiliary_j)
            if self.heat_j > 0.0:
                self._cool()
            return
        if net_j >= 0.0:
            self.drawn_j += net_j
        elif not self.receptive:
            self.resistor_j -= net_j
            self.heat_j -= net_j
            net_j = 0.0
        else:
            self.returned_j -= net_j
        self._load_line(net_j)
        if self.heat_j > 0.0:
            self._cool()

    # On the network of a line.

    def join(self) -> None:
        """From now on the network of a line feeds the train."""
        self.networked = True
        self.connect(None, breaker_closed=self.breaker_closed)

    def _owe(self, traction_j: float, braking_j: float, auxiliary_j: float) -> None:
        if traction_j > 0.0:
            self._wished_j += traction_j / max(LEAST_EFFORT_RATIO, self.effort_ratio)
        self._pulled_j += traction_j
        self._braked_j += braking_j
        self._rest_j += auxiliary_j

    def take_load(self, interval_s: float) -> tuple[Wish, Due]:
        """Of the steps since the last time, which took so long, and what is to be booked when the
        network has answered. Off the network it is nothing."""
        due = Due(self._wished_j, self._pulled_j, self._braked_j, self._rest_j)
        self._wished_j = self._pulled_j = self._braked_j = self._rest_j = 0.0
        wish = Wish(
            due.wished_j / interval_s, due.braked_j / interval_s, due.auxiliary_j / interval_s
        )
        return wish, due

    def fed(
        self,
        voltage_v: float,
        chopped_ratio: float,
        effort_ratio: float,
        due: Due,
        interval_s: float,
    ) -> None:
        """What the network answered to a load: book it, and obey the voltage.

        Args:
            chopped_ratio: share of the regenerated power that the voltage leaves to the resistor.
            effort_ratio: share of traction's effort that it leaves.
            due: as `take_load` gave it.
        """
        if not self._on_network:
            return
        _, pulled_j, braked_j, rest_j = due
        chopped_j = min(1.0, chopped_ratio) * braked_j
        net_j = pulled_j + rest_j - braked_j + chopped_j
        if net_j >= 0.0:
            self.drawn_j += net_j
        else:
            self.returned_j -= net_j
        self.resistor_j += chopped_j
        self.heat_j += chopped_j
        self.voltage_v = voltage_v
        self.current_a = net_j / interval_s / voltage_v
        if not self.live:
            return
        self.effort_ratio = min(effort_ratio, self.effort_ratio + RECOVERS_RATIO)
        self._bound_electric(chopped_ratio, braked_j / interval_s)

    def _bound_electric(self, chopped_ratio: float, braked_w: float) -> None:
        """What of the braking the line does not take has to find room in the resistor."""
        resistor = self._config.resistor
        borne_w = 0.0
        if resistor is not None:
            left_j = resistor.heat_max_j - self.heat_j
            borne_w = max(0.0, min(resistor.max_power_w, left_j / resistor.fade_s))
        if chopped_ratio * braked_w <= borne_w or self._electric_ratio == 0.0:
            self.electric_limit_w = inf
        else:
            taken_w = (1.0 - min(1.0, chopped_ratio)) * braked_w
            self.electric_limit_w = (taken_w + borne_w) / self._electric_ratio

    def _load_line(self, net_j: float) -> None:
        """Voltage, current and the effort that they leave, when a step takes so much."""
        config, no_load_v, step_s = self._config, self._no_load_v, self._step_s
        # V * (V0 - V) / R = P; beyond the source's greatest power the voltage stays at half.
        root = no_load_v**2 - 4.0 * config.source_ohm * net_j / step_s
        self.voltage_v = 0.5 * (no_load_v + (sqrt(root) if root > 0.0 else 0.0))
        self.current_a = net_j / step_s / self.voltage_v
        if self.voltage_v < config.full_effort_v:
            span_v = config.full_effort_v - config.no_effort_v
            self.effort_ratio = max(0.0, (self.voltage_v - config.no_effort_v) / span_v)
        else:
            self.effort_ratio = 1.0

    def supply(self) -> LineSupply:
        return LineSupply(
            line_voltage_v=self.voltage_v,
            line_current_a=self.current_a,
            breaker_closed=self.breaker_closed,
        )

    def meter(self) -> EnergyMeter:
        """What the meter at the collector shows."""
        return EnergyMeter(
            drawn_kwh=self.drawn_j / J_PER_KWH, regenerated_kwh=self.returned_j / J_PER_KWH
        )
