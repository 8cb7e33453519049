"""Runs an FMU as a plant: `python -m metro_hil.foreign_plant.host MAPPING` speaks the protocol.

The FMU has a process of its own, so that neither its crash nor its endless loop stops the bench.
"""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

from firmware_py.assertions import require_assertions
from firmware_py.grants import GrantProtocolError
from firmware_py.settings import SettingsError
from metro_hil.foreign_plant.fmu import FmuError
from metro_hil.foreign_plant.fmu_plant import FmuPlant
from metro_hil.foreign_plant.messages import (
    VERSION,
    OfPlant,
    PlantGrant,
    PlantHello,
    PlantReady,
    PlantRefuse,
    PlantYield,
    encode,
    read_bench,
)


def main(argv: Sequence[str]) -> int:
    require_assertions("plant")
    if len(argv) != 1:
        print("usage: python -m metro_hil.foreign_plant.host MAPPING", file=sys.stderr)
        return 2
    # What the FMU prints must not mix with the answers.
    with os.fdopen(os.dup(1), "wb", buffering=0) as wire:
        os.dup2(2, 1)
        try:
            return _serve(Path(argv[0]), sys.stdin.buffer, wire)
        except (FmuError, GrantProtocolError) as error:
            print(error, file=sys.stderr)
            return 1


def _serve(path: Path, lines: BinaryIO, wire: BinaryIO) -> int:
    plant: FmuPlant | None = None
    try:
        for line in lines:
            message = read_bench(line)
            answer: OfPlant
            if isinstance(message, PlantHello):
                try:
                    plant = FmuPlant(path, message.told)
                    frames, serial = plant.first
                    answer = PlantReady(
                        VERSION, plant.provides, path.stem, tuple(frames), tuple(serial)
                    )
                except (SettingsError, FmuError) as error:
                    answer = PlantRefuse(str(error))
            elif isinstance(message, PlantGrant) and plant is not None:
                truth, frames, serial = plant.step(message.now_ns, message.inputs, message.frames)
                answer = PlantYield(message.now_ns, dict(truth), tuple(frames), tuple(serial))
            else:
                answer = PlantYield(getattr(message, "now_ns", 0))
            wire.write(encode(answer))
    finally:
        if plant is not None:
            plant.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
