"""A line with the paper's protocol, generated from a seed like that of the real one."""

import random
from typing import Final

from metro_hil.simulation.event_queue import Codec
from metro_hil.simulation.paper_protocol import PaperNodes, PaperSettings
from metro_hil.simulation.trace import Teller
from metro_hil.simulation.world import Setting, SimulatedLine

THIRD_PARTY: Final = 100
LINE_END_M: Final = 6000.0


def paper_world(
    seed: int, *, codec: Codec | None = None, tell: Teller | None = None
) -> SimulatedLine:
    """Return a line of two to six trains.

    `codec` must be None, because these messages have no encoding.
    """
    assert codec is None
    rng = random.Random(seed ^ 0x9A9E)
    trains = tuple(range(1, rng.randint(2, 6) + 1))
    fronts_m = {train: 150.0 + 500.0 * train + rng.uniform(0.0, 300.0) for train in trains}
    settings = PaperSettings(trains, THIRD_PARTY, LINE_END_M, roll_back_m=2.0)
    setting = Setting(fronts_m, stops_m=[500.0 * n for n in range(1, 12)])
    return SimulatedLine(seed, setting, PaperNodes(settings), tell=tell)
