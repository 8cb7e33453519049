"""What protection lets a controller hand over to the one that goes on over another path.

That is the controller of the other cab, or of the same cab where the path leads on.

Only the place goes over, and only from a train that is proven to stand without an emergency. The
authority does not: it was given for the other path, so the new controller waits for its own.
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
    """The line of the path by which the train leaves, as far as a hand-over needs it."""

    start_m: float
    end_m: float
    translated_m: Callable[[float], float]
    """From chainages of the path that the train came by to those of the path that it leaves by."""
    turns: bool = True
    """Whether the train leaves with its other cab in front."""


def hand_over(
    record: OdometryRecord,
    path: OtherPath,
    *,
    train_length_m: float,
    standstill: bool,
    emergency: bool,
    width_m_max: float,
) -> OdometryRecord:
    """State in which odometry starts on the other path.

    If the train changes ends, its new front is its old rear. The interval is then that of the old
    front, widened by the error of the train's length. The place counts once the cold-movement
    detector confirms that the train was not moved meanwhile. In any other case it is unknown.

    Args:
        record: state of odometry in the controller that is switched off.
        standstill: zero speed is proven.
        emergency: an emergency is latched.
        width_m_max: width of the interval beyond which a place does not count.
    """
    back_m, error_m = (train_length_m, LENGTH_ERROR_M) if path.turns else (0.0, 0.0)
    bound_m = record.bound_m + error_m
    known = record.proof is not PlaceProof.UNKNOWN and 2.0 * bound_m <= width_m_max
    if not (known and standstill and not emergency):
        return OdometryRecord(
            front_m=(path.start_m + path.end_m) / 2.0,
            bound_m=(path.end_m - path.start_m) / 2.0,
            m_per_pulse=record.m_per_pulse,
            proof=PlaceProof.UNKNOWN,
        )
    return OdometryRecord(
        front_m=path.translated_m(record.front_m - back_m),
        bound_m=bound_m,
        m_per_pulse=record.m_per_pulse,
        proof=PlaceProof.REMEMBERED,
    )
