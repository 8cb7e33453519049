"""Rules for a controller's answers under attack. Pure functions."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from can_dbc.vobc import Supervision
from vobc.atp import ProtectionVerdict
from vobc.vocabulary import CycleOutput

LAG_NS: Final = 850_000_000
"""Longest time for which a withdrawn permission may still be used after its frame was lost. The
longest timeout of an input on the bus is 0.75 s, and a cycle may pass before and after it."""
FORCE_MAX_N: Final = 400_000.0
BRAKED: Final = (Supervision.EMERGENCY, Supervision.NO_AUTHORITY)


@dataclass(frozen=True, slots=True)
class Permits:
    """The permissive parts of an answer."""

    released: bool
    traction: bool
    """Permission by ATP; what ATO does with it depends on the position that the train assumes."""
    left: bool
    right: bool


NOTHING: Final = Permits(released=False, traction=False, left=False, right=False)


def permits(verdict: ProtectionVerdict | None) -> Permits:
    """Return the permissions of ATP alone, so that a low demand of ATO hides nothing."""
    if verdict is None:
        return NOTHING
    return Permits(
        verdict.emergency_released,
        verdict.traction_permitted,
        verdict.doors.left,
        verdict.doors.right,
    )


def differences(output: CycleOutput, genuine: CycleOutput) -> Iterator[str]:
    """Yield the differences; noise must leave the answer unchanged."""
    if output != genuine:
        names = [
            name
            for name in CycleOutput.__dataclass_fields__
            if getattr(output, name) != getattr(genuine, name)
        ]
        yield f"noise changed {', '.join(names)}"


class Shadow:
    """Remembers what the undisturbed controller permitted lately."""

    def __init__(self) -> None:
        self._lately: deque[tuple[int, Permits]] = deque()

    def more_permissive(self, now_ns: int, got: Permits, genuine: Permits) -> Iterator[str]:
        """Yield permissions that the undisturbed controller did not give lately."""
        lately = self._lately
        lately.append((now_ns, genuine))
        while lately[0][0] < now_ns - LAG_NS:
            lately.popleft()
        for name in Permits.__dataclass_fields__:
            if getattr(got, name) and not any(getattr(each, name) for _, each in lately):
                yield f"{name}, which the undisturbed controller did not permit"


def broken_rules(output: CycleOutput) -> Iterator[str]:
    """Yield violations of the rules that hold for every input, genuine or forged."""
    drives = output.traction_permitted or output.force_n > 0.0
    if drives and not output.emergency_released:
        yield "traction while the emergency brake is on"
    if output.force_n > 0.0 and output.service_decel_mps2 > 0.0:
        yield "traction against the brake"
    if not 0.0 <= output.force_n <= FORCE_MAX_N:
        yield f"force of {output.force_n} N"
    if not output.service_decel_mps2 >= 0.0:
        yield f"brake demand of {output.service_decel_mps2} m/s²"
    if output.supervision in BRAKED and output.emergency_released:
        yield f"emergency brake released in {output.supervision.name}"
    yield from _broken_door_rules(output)


def _broken_door_rules(output: CycleOutput) -> Iterator[str]:
    motion = output.motion
    enabled = output.enable_left or output.enable_right
    if (output.open_left and not output.enable_left) or (
        output.open_right and not output.enable_right
    ):
        yield "doors commanded to open on a side that is not enabled"
    if not enabled:
        return
    if motion is None or not motion.standstill:
        yield "doors enabled without proven standstill"
    if output.force_n > 0.0:
        yield "doors enabled while tractive effort acts"
    if output.enable_left and output.enable_right:
        yield "doors enabled on both sides of a line with platforms on one"
