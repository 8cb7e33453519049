"""Parts of the train that a program outside the bench emulates, and the truth that it reports."""

from collections.abc import Collection, Mapping
from typing import Final, Protocol

from can_dbc.nodes import Node

MOTION: Final = "motion"
"""Name of the part that moves the train; all other parts are nodes of the bus."""
BOOLEANS: Final = (
    "emergency",
    "holding",
    "doors_locked",
    "left_open",
    "right_open",
    "traction_cut",
    "fire",
    "obstacle",
)
"""Truth signals that are 0 or 1."""
TRUTH_OF: Final[Mapping[str, tuple[str, ...]]] = {
    MOTION: ("front_m", "speed_mps", "accel_mps2"),
    Node.BCU.name: ("brake_n", "emergency", "emergency_mps2", "holding"),
    Node.TCU.name: ("drive_n", "traction_cut"),
    Node.DCU.name: ("doors_locked", "left_open", "right_open", "left_cars", "right_cars"),
    Node.ODO.name: ("odometer_error_m",),
    Node.BTM.name: ("tags_read",),
    Node.DESK.name: (),
    Node.HVB.name: ("voltage_v",),
    Node.TCMS.name: ("fire", "obstacle"),
}
"""Truth signals that the program reports for each part that it provides."""
LIMITS: Final[Mapping[str, tuple[float, float]]] = {
    **dict.fromkeys(BOOLEANS, (0.0, 1.0)),
    "front_m": (-1.0e6, 1.0e6),
    "speed_mps": (-150.0, 150.0),
    "accel_mps2": (-1.0e3, 1.0e3),
    "brake_n": (0.0, 1.0e8),
    "emergency_mps2": (0.0, 1.0e2),
    "drive_n": (-1.0e8, 1.0e8),
    "left_cars": (0.0, 2.0**24 - 1.0),
    "right_cars": (0.0, 2.0**24 - 1.0),
    "odometer_error_m": (-1.0e6, 1.0e6),
    "tags_read": (0.0, 1.0e6),
    "voltage_v": (0.0, 1.0e5),
}
"""Range of each signal. A value outside it is a mistake of the program, such as a wrong unit."""
INPUTS: Final = ("drive_n", "motor_brake_n", "trailer_brake_n", "gradient_permille")
"""What the bench's own actuators and line do to the train in the present step: signed tractive
effort, brake forces of motor cars and of trailers, and the mean gradient under the train."""


class ForeignPartsError(Exception):
    """The program ended, hung or broke the protocol during a run; the text says when and how."""


class ForeignParts(Protocol):
    """A program that emulates parts of the train in place of the bench."""

    @property
    def moves(self) -> bool:
        """Whether it computes the motion of the train."""
        ...

    @property
    def nodes(self) -> frozenset[Node]:
        """The nodes of the bus that it emulates."""
        ...

    def step(self, end_ns: int, inputs: Mapping[str, float]) -> Mapping[str, float]:
        """Advance it to `end_ns` and return the truth of its parts.

        Args:
            inputs: a value for each of INPUTS.
        """
        ...

    def take_frames(self) -> list[tuple[Node, int, bytes]]:
        """Return the frames that its nodes send after the last step."""
        ...

    def take_serial(self) -> list[bytes]:
        """Return the bytes that its tag reader sends after the last step."""
        ...

    def stop(self) -> None:
        """Let it send its last output and end."""
        ...


def signals_of(moves: bool, nodes: Collection[Node]) -> tuple[str, ...]:
    """Return the truth signals that such a program reports."""
    parts = ([MOTION] if moves else []) + [node.name for node in sorted(nodes)]
    return tuple(name for part in parts for name in TRUTH_OF[part])
