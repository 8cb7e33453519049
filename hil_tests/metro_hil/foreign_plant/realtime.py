"""Serves a train in real time of which another program emulates parts.

`python -m metro_hil.foreign_plant.realtime PLANT run ...`: PLANT is a `PlantSpec` in JSON, and the
other words are those of `plant run`.
"""

import sys
from collections.abc import Sequence
from contextlib import ExitStack

import msgspec

from firmware_py.assertions import require_assertions
from firmware_py.buses import open_can
from firmware_py.clock.clock import Clock
from firmware_py.settings import SettingsError
from metro_hil.foreign_plant.checks import received_ids
from metro_hil.foreign_plant.choice import start_plant
from metro_hil.foreign_plant.plant import ForeignPlant, PlantStartError
from metro_hil.model.case import PlantSpec
from plant_emulator.cli.command import serve
from plant_emulator.cli.options import parser
from plant_emulator.world import TrainScenario


def main(argv: Sequence[str]) -> int:
    require_assertions("plant")
    spec = msgspec.json.decode(argv[0], type=PlantSpec)

    def start(scenario: TrainScenario, bus: str, clock: Clock, stack: ExitStack) -> ForeignPlant:
        port = open_can(bus, clock=clock, node="PROGRAM", accept_ids=received_ids())
        stack.callback(port.close)
        try:
            foreign = start_plant(spec, scenario, port)
        except PlantStartError as error:
            # `plant run` puts this word before every message.
            raise SettingsError(str(error).removeprefix("plant: ")) from error
        stack.callback(foreign.close)
        return foreign

    return serve(parser().parse_args(argv[1:]), start)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
