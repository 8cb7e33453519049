"""What protection lets the controller of one cab hand over to that of the other.

Only the place goes over, and only from a train that is proven to stand without an emergency. The
authority does not: it was given for the other direction, so the new controller waits for its own.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from vobc.vocabulary import OdometryRecord, PlaceProof

LENGTH_ERROR_M: Final = 0.5
"""Greatest difference between the declared and the true length of a standing train, m. Its couplers
stretch by decimetres, and the front of one direction is the rear of the other."""


@dataclass(frozen=True, slots=True)
class OtherPath:
    """The line of the other direction, as far as a hand-over needs it."""

    start_m: float
    end_m: float
    translated_m: Callable[[float], float]
    """From chainages of the path that the train came by to those of the path that it leaves by."""


def hand_over(
    record: OdometryRecord,
    path: OtherPath,
    *,
    train_length_m: float,
    standstill: bool,
    emergency: bool,
    width_m_max: float,
) -> OdometryRecord:
    """State in which odometry of the other cab starts.

    The front of the new direction is the rear of the old one. Its interval is that of the old
    front, widened by the error of the train's length. It counts once the cold-movement detector
    confirms that the train was not moved meanwhile. In any other case the place is unknown.

    Args:
        record: state of odometry in the cab that is switched off.
        standstill: zero speed is proven.
        emergency: an emergency is latched.
        width_m_max: width of the interval beyond which a place does not count.
    """
    bound_m = record.bound_m + LENGTH_ERROR_M
    known = record.proof is not PlaceProof.UNKNOWN and 2.0 * bound_m <= width_m_max
    if not (known and standstill and not emergency):
        return OdometryRecord(
            front_m=(path.start_m + path.end_m) / 2.0,
            bound_m=(path.end_m - path.start_m) / 2.0,
            m_per_pulse=record.m_per_pulse,
            proof=PlaceProof.UNKNOWN,
        )
    return OdometryRecord(
        front_m=path.translated_m(record.front_m - train_length_m),
        bound_m=bound_m,
        m_per_pulse=record.m_per_pulse,
        proof=PlaceProof.REMEMBERED,
    )
