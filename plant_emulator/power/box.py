"""High-voltage box: line voltage under the train's own current, and the energy meter.

The line is modelled as one source behind a resistance, which also accepts the current that the
train returns. While the line is not receptive, braking energy feeds the auxiliaries and the brake
resistor takes the rest.
"""

from math import exp, inf, sqrt
from typing import Final, NamedTuple

from can_dbc.energy import EnergyMeter, LineSupply
from plant_emulator.train_config import SupplyConfig

J_PER_KWH: Final = 3.6e6
COLD_J: Final = 1.0e3
"""Heat below which the resistor counts as cold, J."""
RECEPTIVE_RATIO: Final = 1.2
"""Share of its no-load voltage up to which a line accepts returned current; EN 50163 allows this
much."""

RECOVERS_RATIO: Final = 0.1
"""Largest recovery of the effort ratio with each solution of the network. A train that took its
full power at once would pull the voltage down again."""

LEAST_EFFORT_RATIO: Final = 0.05
"""Smallest effort ratio by which the wished power is computed. It bounds the wish of a train that
has almost no effort left."""


class Due(NamedTuple):
    """Energies in J of steps for which the network has no solution yet."""

    wished_j: float = 0.0
    """Energy that traction would take at full voltage."""
    pulled_j: float = 0.0
    braked_j: float = 0.0
    auxiliary_j: float = 0.0


class Wish(NamedTuple):
    """Mean powers of a train since its last request, as they would be at full voltage."""

    traction_w: float
    regenerated_w: float
    auxiliary_w: float


class HighVoltageBox:
    """Power balance of one train in joules: drawn - returned = traction - braking + auxiliary +
    resistor.
    """

    __slots__ = (
        "_auxiliary_w",
        "_braked_j",
        "_config",
        "_cool_ratio",
        "_electric_ratio",
        "_isolated",
        "_no_load_v",
        "_on_network",
        "_pulled_j",
        "_rest_j",
        "_resting",
        "_source_v",
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
        "lowest_v",
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
        """Current from the line, A; negative while the train feeds back."""
        self.effort_ratio = 1.0
        """Share of the tractive effort that the voltage permits."""
        self.traction_j = 0.0
        """Electrical energy into the inverters."""
        self.braking_j = 0.0
        """Electrical energy out of the inverters while the motors brake."""
        self.auxiliary_j = 0.0
        self.drawn_j = 0.0
        self.returned_j = 0.0
        self.resistor_j = 0.0
        """Energy into the brake resistor since the start."""
        self.heat_j = 0.0
        """Heat still stored in the resistor."""
        resistor = config.resistor
        self._cool_ratio = 1.0 if resistor is None else exp(-step_s / resistor.cool_s)
        self.electric_limit_w = inf
        """Power at the rail that the electric brake may take now; 0 forbids electric braking."""
        self._resting = False
        self._isolated = False
        self._source_v: float | None = None
        self._on_network = False
        self.lowest_v = inf
        """Lowest voltage of a network that has fed the train."""
        self.networked = False
        """A line's network feeds the train unless a fault connects another source."""
        self._wished_j = self._pulled_j = self._braked_j = self._rest_j = 0.0
        """Energies of steps that were not requested from the network yet, as in `Due`."""
        self._no_load_v = config.no_load_v
        self._auxiliary_w = config.auxiliary_w
        self.breaker_closed = True
        self.live = True
        """The line feeds the train."""
        self.receptive = True
        """The line accepts energy from the braking motors."""

    def connect(self, no_load_v: float | None, *, breaker_closed: bool) -> None:
        """A fault: connect another source or open the main breaker; None is the train's normal
        source.

        A source too weak for any effort feeds nothing. The auxiliaries then run on the battery,
        which is not metered. A source far above its rating accepts no current, so braking energy
        goes into the resistor. On a network only the breaker counts, and an explicit source
        disconnects the train from it.
        """
        config = self._config
        self._source_v = no_load_v
        if self._isolated:
            no_load_v = 0.0
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

    def isolate(self, isolated: bool) -> None:
        """A zone without voltage begins or ends: inside it the line feeds and takes nothing."""
        self._isolated = isolated
        self.connect(self._source_v, breaker_closed=self.breaker_closed)

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
        """Account for a step in which the motors do nothing."""
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
        """Account for one step.

        Args:
            drive_work_j: work of the tractive effort at the rail. It is negative when the train
                rolls against the effort, which counts as braking.
            brake_work_j: work of the electric brake at the rail; never negative.
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

    def convert(self, traction_ratio: float, electric_ratio: float) -> None:
        """Take these efficiencies of traction and electric brake from now on."""
        self._traction_ratio, self._electric_ratio = traction_ratio, electric_ratio

    # The methods below serve a train on a line's network.

    def join(self) -> None:
        """From now on, the network of a line feeds the train."""
        self.networked = True
        self.connect(None, breaker_closed=self.breaker_closed)

    def _owe(self, traction_j: float, braking_j: float, auxiliary_j: float) -> None:
        if traction_j > 0.0:
            self._wished_j += traction_j / max(LEAST_EFFORT_RATIO, self.effort_ratio)
        self._pulled_j += traction_j
        self._braked_j += braking_j
        self._rest_j += auxiliary_j

    def take_load(self, interval_s: float) -> tuple[Wish, Due]:
        """Return the mean powers over the steps since the last call, which took `interval_s`, and
        the energies to account for after the network's solution.

        Off the network all are zero.
        """
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
        """Account for the network's solution of one load and follow its voltage.

        Args:
            chopped_ratio: share of the regenerated power that goes into the resistor.
            effort_ratio: share of the tractive effort that the voltage permits.
            due: the value that `take_load` returned.
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
        self.lowest_v = min(self.lowest_v, voltage_v)
        self.current_a = net_j / interval_s / voltage_v
        if not self.live:
            return
        self.effort_ratio = min(effort_ratio, self.effort_ratio + RECOVERS_RATIO)
        self._bound_electric(chopped_ratio, braked_j / interval_s)

    def _bound_electric(self, chopped_ratio: float, braked_w: float) -> None:
        """Limit the electric brake to the power that line and resistor accept together."""
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
        """Update voltage, current and permitted effort for a step that takes `net_j`."""
        config, no_load_v, step_s = self._config, self._no_load_v, self._step_s
        # V * (V0 - V) / R = P. Beyond the source's greatest power the voltage stays at half of V0.
        root = no_load_v**2 - 4.0 * config.source_ohm * net_j / step_s
        self.voltage_v = 0.5 * (no_load_v + (sqrt(root) if root > 0.0 else 0.0))
        self.current_a = net_j / step_s / self.voltage_v if self.voltage_v > 0.0 else 0.0
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
        """Build the frame of the meter at the collector."""
        return EnergyMeter(
            drawn_kwh=self.drawn_j / J_PER_KWH, regenerated_kwh=self.returned_j / J_PER_KWH
        )
