"""The console scripts `vobc` and `hil`."""

import sys

from firmware_py.program import TYPE_CHECKING, Program

if TYPE_CHECKING:
    from collections.abc import Callable


def _vobc() -> "Callable[[], int]":
    asks = {"-h", "--help"} & {*sys.argv}
    if sys.argv[1:2] == ["run"] and not asks:
        from metro_hil.model.native_copy import enter

        # A build in the background would disturb a run in real time.
        enter("vobc", builds="--lockstep" in sys.argv)
    from metro_hil.cli.vobc import main

    return main


def _hil() -> "Callable[[], int]":
    if sys.argv[1:2] == ["simulate"] and not {"-h", "--help"} & {*sys.argv}:
        from metro_hil.model.native_copy import Part, enter

        enter("hil", Part.SIMULATOR)
    from metro_hil.cli.hil import main

    return main


vobc = Program("vobc", _vobc)
hil = Program("hil", _hil)
