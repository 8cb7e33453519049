"""Runs a controller again on recorded inputs, step by step."""

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

from firmware_py.clock.executive import Executive
from firmware_py.handed_ports import HandedPorts, SentOutputs
from metro_hil.external_controller import ControllerDiedError, GrantedController, program_of
from metro_hil.model.case import ControllerSpec
from metro_hil.replay.recording import STOP, Output, Segment
from vobc.process import Commission

SHIPPED: Final = ControllerSpec()


class RerunDevice(Protocol):
    """A controller as the replay runs it."""

    executive: Executive

    def stop(self, now_ns: int) -> None: ...


Make = Callable[[Commission, HandedPorts], RerunDevice]


@dataclass(frozen=True, slots=True)
class Rerun:
    """Outputs of the controller in this run."""

    outputs: tuple[tuple[Output, ...], ...]
    """Outputs of each step of the segment; fewer if the controller died."""
    died: str = ""
    """The exception that ended the controller, or how its process ended."""


def maker(controller: ControllerSpec) -> Make:
    """Maker of the controller. Raises ControllerStartError for a missing program."""
    if controller.kind == SHIPPED.kind:
        return _in_this_process
    program = program_of(controller)

    def granted(commission: Commission, ports: HandedPorts) -> RerunDevice:
        return GrantedController(
            program,
            commission,
            can=ports.can,
            tags=ports.tags,
            radio=ports.radio,
            lease_s=controller.lease_s,
        )

    return granted


def _in_this_process(commission: Commission, ports: HandedPorts) -> RerunDevice:
    return commission.device(can=ports.can, tags=ports.tags, radio=ports.radio)


def rerun(segment: Segment, make: Make, commission: Commission) -> Rerun:
    """Run every step at its recorded time with its recorded inputs. Raises ControllerStartError."""
    ports = HandedPorts()
    device = make(commission, ports)
    outputs: list[tuple[Output, ...]] = []
    try:
        for step in segment.steps:
            ports.hand(step.frames, step.chunks, step.messages)
            if step.task == STOP:
                device.stop(step.begin_ns)
            else:
                device.executive.run_next(step.begin_ns, step.execution_ns)
            outputs.append(_outputs(ports.take()))
    except ControllerDiedError as error:
        return Rerun(tuple(outputs), str(error))
    except Exception as error:
        # Before the exception, the controller sent its safe output, which counts as well.
        outputs.append(_outputs(ports.take()))
        return Rerun(tuple(outputs), traceback.format_exception_only(error)[-1].strip())
    finally:
        if isinstance(device, GrantedController):
            device.close()
    return Rerun(tuple(outputs))


def _outputs(said: SentOutputs) -> tuple[Output, ...]:
    return (
        *(Output("can", f"{can_id:03X}", data) for can_id, data in said.frames),
        *(Output("tags", "", data) for data in said.serial),
        *(Output("radio", key, payload) for key, payload in said.radio),
    )
