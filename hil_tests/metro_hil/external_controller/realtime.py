"""`vobc host`: runs a controller that speaks the lockstep interface in real time on a bus."""

import argparse
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Final

from firmware_py.arguments import of_file
from firmware_py.assertions import require_assertions
from firmware_py.buses import BusError, open_can
from firmware_py.clock.clock import REALTIME_SPIN_S, WallClock
from firmware_py.clock.executive import run
from firmware_py.clock.realtime import die_with_parent, enter_realtime
from firmware_py.interrupts import Interrupts
from firmware_py.radio.zenoh_radio import RadioError, SessionRole, open_radio
from firmware_py.settings import SettingsError
from firmware_py.storage.nvram import NvramRecord
from metro_hil.external_controller.controller import GrantedController
from metro_hil.external_controller.link import ControllerDiedError, ControllerProgram
from metro_hil.model.run_options import EXIT_ENVIRONMENT, EXIT_FAILED, EXIT_USAGE
from metro_hil.model.subprocesses import with_own_python
from vobc.cli import options as device
from vobc.cli.host import PatientLine
from vobc.process import Commission
from zenoh_config import keys

NS_PER_S: Final = 1_000_000_000
END_OF_OPTIONS: Final = "--"
DESCRIPTION: Final = (
    "Run a controller that speaks the lockstep interface in real time: this program moves frames, "
    "bytes of the tag reader and radio messages between it and the wires, and wakes it by the "
    "clock. Options as for `vobc device`, then -- and the controller's command."
)


def main(argv: Sequence[str] | None = None) -> int:
    """Parse, check, run. A user error gives one line."""
    require_assertions("vobc")
    words = list(sys.argv[1:] if argv is None else argv)
    at = words.index(END_OF_OPTIONS) if END_OF_OPTIONS in words else len(words)
    options = parser().parse_args(words[:at])
    command = tuple(words[at + 1 :])
    try:
        if not command:
            raise SettingsError("host: no command; put -- and the controller's command at the end")
        return _run(options, device.plan(options, WallClock().epoch_ns()), command)
    except SettingsError as error:
        return _complain(str(error), EXIT_USAGE)
    except (BusError, RadioError) as error:
        return _complain(str(error), EXIT_ENVIRONMENT)
    except OSError as error:
        return _complain(of_file(error), EXIT_ENVIRONMENT)
    except ControllerDiedError as error:
        return _complain(f"{error}; the train brakes without it", EXIT_FAILED)


def parser() -> argparse.ArgumentParser:
    """The options of `vobc device`; the command follows them."""
    top = device.parser()
    top.prog = "vobc host"
    top.description = DESCRIPTION
    top.usage = "vobc host [OPTION ...] -- COMMAND ..."
    top.epilog = None
    return top


def _complain(text: str, code: int) -> int:
    print(f"vobc: {text}", file=sys.stderr, flush=True)
    return code


def _run(options: argparse.Namespace, planned: device.DevicePlan, command: tuple[str, ...]) -> int:
    if options.parent is not None:
        die_with_parent(options.parent)
    ending = Interrupts()
    with ending.caught(), ExitStack() as stack:
        clock = WallClock(spin_s=REALTIME_SPIN_S if options.priority else 0.0)
        stack.callback(planned.nvram.close)
        can = open_can(planned.bus, clock=clock, node="VOBC")
        stack.callback(can.close)
        tags = PatientLine(planned.tags)
        stack.callback(tags.close)
        line, train = planned.line.name, planned.config.address
        topics = (keys.authorities(line, train), keys.orders(line, train))
        radio = open_radio(SessionRole.TRAIN, planned.radio, topics, clock)
        stack.callback(radio.close)
        commission = Commission(
            config=planned.config,
            line=planned.line,
            mission=planned.mission,
            nvram=planned.nvram.record,
            start_ns=clock.now_ns(),
            start=planned.start,
        )
        # The next start counts on, and knows that nothing tells where the train stands.
        record = planned.nvram.record
        planned.nvram.put(NvramRecord(boot_count=record.boot_count + 1))
        program = ControllerProgram(command, with_own_python(os.environ))
        controller = GrantedController(program, commission, can=can, tags=tags, radio=radio)
        stack.callback(controller.close)
        if options.priority:
            enter_realtime(options.priority)
        end_ns = None
        if options.duration is not None:
            end_ns = clock.now_ns() + round(options.duration * NS_PER_S)

        def until(now_ns: int) -> bool:
            return ending.asked or (end_ns is not None and now_ns >= end_ns)

        run([controller.executive], clock, until)
        controller.stop(clock.now_ns())
    return ending.exit_code


if __name__ == "__main__":
    sys.exit(main())
