"""Base of laws that only limit the predictive law. The predictive law drives and stops."""

from firmware_py.trackdb import LineMap
from vobc.ato.laws.predictive import Predictive
from vobc.ato.settings.ato import AtoConfig
from vobc.vocabulary import AtoInput


class OverPredictive:
    """Passes all calls on to the predictive law."""

    __slots__ = ("_config", "_demand_mps2", "_drives", "_line")

    def __init__(self, config: AtoConfig, line: LineMap, dt_s: float) -> None:
        self._config = config
        self._line = line
        self._drives = Predictive(config, line, dt_s)
        self._demand_mps2 = 0.0

    @property
    def speed_mps(self) -> float:
        return self._drives.speed_mps

    def observe(self, inputs: AtoInput, cycles: int) -> None:
        self._drives.observe(inputs, cycles)

    def rest(self) -> None:
        self._drives.rest()

    def set_off(self, inputs: AtoInput, demand_mps2: float) -> None:
        self._drives.set_off(inputs, demand_mps2)

    def issued(self, demand_mps2: float) -> None:
        self._demand_mps2 = demand_mps2
        self._drives.issued(demand_mps2)
