"""Control by chasing time as printed in [Wu 2022]. It is unstable and kept to show that."""

from dataclasses import replace
from typing import Final

from firmware_py.trackdb import LineMap
from vobc import vocabulary
from vobc.ato.laws import catch_time
from vobc.ato.laws.chasing import Chasing
from vobc.ato.laws.law import Target
from vobc.ato.laws.notch_choice import NotchTarget
from vobc.ato.model.predictor import PredictedState
from vobc.ato.model.train_model import TrainModel
from vobc.ato.settings.ato import AtoConfig

LONGEST_S: Final = 3.0
"""Longest dead time that the model of the brake takes."""


class ChasingLiteral(Chasing):
    """The printed rule alone, down to the stop, over the whole time to the target.

    Both sentences of the paper apply to "the target speed is less than the present one". The second
    asks for a catch time longer than the time to the target, which selects a notch that comes too
    late. Hysteresis, dwell and the end of a stop are not printed and not implemented here, nor are
    the two additions.
    """

    __slots__ = ()

    def __init__(self, config: AtoConfig, line: LineMap, dt_s: float) -> None:
        bare = replace(config.chasing, early_transition=False, small_brake=False)
        super().__init__(replace(config, chasing=bare), line, dt_s)

    @staticmethod
    def _make_model(config: AtoConfig, dt_s: float) -> TrainModel:
        """The brake as it is assumed: nothing is identified."""
        scheme = config.chasing
        assumed_s = min(scheme.dead_time_s, LONGEST_S)
        brake = replace(
            config.brake,
            dead_times_s=(assumed_s,),
            expected_dead_time_s=assumed_s,
            lag_s=scheme.lag_s,
            air_delays_s=(0.0,),
        )
        return TrainModel(brake, config.traction, dt_s, weak_ratio=0.0)

    def _brake_on(
        self, inputs: vocabulary.AtoInput, ahead: PredictedState, target: Target, aim: NotchTarget
    ) -> None:
        self._take(self._chosen_brake_mps2(ahead, aim))

    def _chosen_brake_mps2(self, ahead: PredictedState, aim: NotchTarget) -> float:
        resistance_mps2 = self._resistance_mps2(ahead.front_m)
        levels_mps2 = (0.0, *self._config.output.brake_levels_mps2)
        index = catch_time.last_too_late(
            aim.error_mps,
            [resistance_mps2 + level_mps2 for level_mps2 in levels_mps2],
            reference_mps2=aim.decel_mps2,
            within_s=aim.run_s / self._config.chasing.chase_ratio,
            guard_mps2=self._config.chasing.guard_mps2,
        )
        return self.notch_mps2 if index is None else -levels_mps2[index]
