"""`python -m plant_emulator.cli.grant`: train and wayside in virtual time, driven by time grants.

It is the other side of the lockstep protocol: it receives the frames, serial bytes and radio
messages of the controller, and yields those of train and wayside, with the truth of the train.
"""

import os
import sys
from typing import Any, BinaryIO, Final

import msgspec

from firmware_py import __version__, grants
from firmware_py.assertions import require_assertions
from firmware_py.handed_ports import HandedPorts
from firmware_py.settings import SettingsError
from plant_emulator.foreign import signals_of
from plant_emulator.process import PlantDevice
from plant_emulator.truth import Truth
from plant_emulator.wire import PLANT_NODES
from plant_emulator.world import plan_scenario

EXIT_OK: Final = 0
EXIT_USAGE: Final = 2
TRUTH: Final = signals_of(True, PLANT_NODES)
"""Truth signals of each yield, in this order."""
OPTIONS: Final = ("line", "consist", "seed", "start", "end", "load_ratio", "odometer_error_ratio")
"""Members of `told` in hello: the options of `plan_scenario`."""

_encoder: Final = msgspec.json.Encoder()


class GrantedPlant:
    """The plant of one run."""

    def __init__(self, told: dict[str, Any]) -> None:
        """Raises SettingsError."""
        unknown = [name for name in told if name not in OPTIONS]
        if unknown:
            raise SettingsError(f"hello: told.{unknown[0]}: none of {', '.join(OPTIONS)}")
        try:
            scenario = plan_scenario(**told)
        except TypeError as error:
            raise SettingsError(f"hello: told: {error}") from error
        self._ports = HandedPorts()
        self._truth = Truth()
        self._device = PlantDevice(
            scenario,
            open_port=lambda node, ids: self._ports.can,
            tags=self._ports.tags,
            radio=self._ports.radio,
            truth=None,
            start_ns=0,
            observer=self._observe,
        )

    def _observe(self, truth: Truth, now_ns: int) -> None:
        self._truth = truth

    @property
    def next_wakeup_ns(self) -> int:
        return self._device.executive.next_due_ns()

    def run(self, message: grants.Grant) -> None:
        """Advance to the instant of the grant."""
        self._ports.hand(
            grants.heard_frames(message),
            grants.heard_chunks(message),
            grants.heard_messages(message),
        )
        self._device.executive.run_next(message.now_ns)

    def stop(self, now_ns: int) -> None:
        self._device.stop(now_ns)

    def answer(self, now_ns: int) -> bytes:
        """Return the line of the yield."""
        yielded = grants.yielded(now_ns, self.next_wakeup_ns, self._ports.take())
        truth = [getattr(self._truth, name) for name in TRUTH]
        return _encoder.encode({**msgspec.to_builtins(yielded), "truth": truth}) + b"\n"


def serve(lines: BinaryIO, wire: BinaryIO) -> int:
    """Answer until the other side stops the run or disconnects. Raises GrantProtocolError."""
    plant: GrantedPlant | None = None
    for line in lines:
        message = grants.read_bench(line)
        if isinstance(message, grants.Hello):
            try:
                plant = GrantedPlant(message.told)
            except SettingsError as error:
                wire.write(grants.encode(grants.Refuse(str(error))))
                return EXIT_USAGE
            name = f"plant {__version__}"
            wire.write(grants.encode(grants.Ready(grants.VERSION, plant.next_wakeup_ns, name)))
        elif plant is None:
            raise grants.GrantProtocolError("the other side does not start with hello")
        elif isinstance(message, grants.Grant):
            plant.run(message)
            wire.write(plant.answer(message.now_ns))
        else:
            plant.stop(message.now_ns)
            wire.write(plant.answer(message.now_ns))
            return EXIT_OK
        wire.flush()
    return EXIT_OK


def main() -> int:
    """Serve standard input and output; other printed text goes to standard error."""
    require_assertions("plant")
    with os.fdopen(os.dup(1), "wb") as wire:
        os.dup2(2, 1)
        try:
            return serve(sys.stdin.buffer, wire)
        except grants.GrantProtocolError as error:
            print(f"plant: grant: {error}", file=sys.stderr)
            return EXIT_USAGE


if __name__ == "__main__":
    sys.exit(main())
