"""External controllers in virtual time: older versions and other programs in their own processes.

`docs/reference/lockstep_interface.md` describes the messages between bench and controller.
"""

from metro_hil.external_controller.controller import GrantedController
from metro_hil.external_controller.link import (
    ControllerDiedError,
    ControllerProgram,
    ControllerStartError,
)
from metro_hil.external_controller.programs import program_of

__all__ = [
    "ControllerDiedError",
    "ControllerStartError",
    "ControllerProgram",
    "GrantedController",
    "program_of",
]
