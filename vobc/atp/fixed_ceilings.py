"""Fixed ceilings that need no known place: driving on sight, creep, jog."""

from vobc.atp.config import AtpConfig
from vobc.vocabulary import Ceiling


class FixedCeilings:
    """One speed each, with separate small margins."""

    def __init__(self, config: AtpConfig) -> None:
        self.restricted = _flat(config, config.restricted_mps)
        self.creep = _flat(config, config.creep_mps)
        self.jog = _flat(config, config.jog_mps)

    @staticmethod
    def under(known: Ceiling, flat: Ceiling) -> Ceiling:
        """The lower of both in each speed. The distance to the end of authority is that of `known`,
        and its target while that lowers the permitted speed.
        """
        return Ceiling(
            min(known.permitted_mps, flat.permitted_mps),
            min(known.warning_mps, flat.warning_mps),
            min(known.service_mps, flat.service_mps),
            min(known.emergency_mps, flat.emergency_mps),
            known.distance_to_authority_m,
            known.target if known.permitted_mps < flat.permitted_mps else None,
        )


def _flat(config: AtpConfig, speed_mps: float) -> Ceiling:
    return Ceiling(
        speed_mps,
        speed_mps + config.flat_warning_margin_mps,
        speed_mps + config.flat_service_margin_mps,
        speed_mps + config.flat_emergency_margin_mps,
        0.0,
    )
