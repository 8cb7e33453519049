"""Control by chasing time as Wu 2022 prints it, which runs away; kept to show that it does."""

from vobc.ato import catch_time
from vobc.ato.strategies.chasing import Aim, Chasing


class ChasingLiteral(Chasing):
    """For a train that is too slow the notch that catches the curve only after the target."""

    __slots__ = ()

    def _pick(self, aim: Aim, levels_mps2: list[float], resistance_mps2: float) -> float:
        decels_mps2 = [resistance_mps2 - level_mps2 for level_mps2 in levels_mps2]
        guard_mps2 = self._config.chasing.guard_mps2
        rule = catch_time.gentlest if aim.error_mps > 0.0 else catch_time.first_too_late
        index = rule(
            aim.error_mps,
            decels_mps2,
            reference_mps2=aim.decel_mps2,
            within_s=aim.run_s,
            guard_mps2=guard_mps2,
        )
        if index is not None:
            return levels_mps2[index]
        return levels_mps2[-1] if aim.error_mps > 0.0 else self.notch_mps2
