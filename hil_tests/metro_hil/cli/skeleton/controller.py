"""A controller of your own: it drives one train from its first station to the next and stops there.

Run it with `hil run controller.toml` in this folder. The bench starts this program and talks to it
in lines of JSON (docs/reference/lockstep_interface.md). It decides in `MyController.step`;
everything else is transport. It has no ATP: replace `step` with your own logic.
"""

import json
import math
import sys
from typing import Any

from can_dbc.binding import Frame
from can_dbc.brake import BrakeCommand
from can_dbc.codec import Decoder, Encoder
from can_dbc.doors import DoorCommand
from can_dbc.nodes import Direction
from can_dbc.odometer import Doppler, Tacho
from can_dbc.traction import TractionCommand

CYCLE_NS = 50_000_000
CRUISE_MPS = 12.0
ACCEL_MPS2 = 0.6
BRAKE_MPS2 = 0.7
"""Deceleration of the approach; the train of train.toml can do 1.0 m/s²."""
STANDSTILL_MPS = 0.6
"""The radar measures nothing below 0.5 m/s."""
PULSES = 65536
"""The counter of TACHO starts again at 0 after this many pulses."""


class MyController:
    """The decisions. `step` is called once each cycle with the newest inputs."""

    def __init__(
        self, line: dict[str, Any], params: dict[str, Any], mission: dict[str, Any]
    ) -> None:
        stations = {station["name"]: station for station in line["stations"]}
        start, stop = stations[mission["start"]], stations[mission["stops"][0]]
        self._to_stop_m = stop["stop_m"] - start["stop_m"]
        train = params["train"]
        self._m_per_pulse = math.pi * train["wheel_diameter_m"] / train["pulses_per_turn"]
        # With full load, as this train does not know how many passengers it carries.
        self._mass_kg = (train["tare_kg"] + train["full_load_kg"]) * (
            1.0 + train["rotating_mass_ratio"]
        )
        self._pulses: int | None = None
        self._stopped = False

    def step(self, tacho: Tacho | None, doppler: Doppler | None) -> list[Frame]:
        """The frames to send in this cycle."""
        if tacho is None or doppler is None:
            return self._braked()
        if self._pulses is not None:
            self._to_stop_m -= ((tacho.pulses_a - self._pulses) % PULSES) * self._m_per_pulse
        self._pulses = tacho.pulses_a
        speed_mps = doppler.speed_mps
        wanted_mps = min(CRUISE_MPS, math.sqrt(max(0.0, 2.0 * BRAKE_MPS2 * self._to_stop_m)))
        self._stopped = self._stopped or (self._to_stop_m < 1.0 and speed_mps < STANDSTILL_MPS)
        if self._stopped:
            return self._braked()
        if speed_mps > wanted_mps:
            # Brake harder the more the train is too fast.
            return self._commands(0.0, BRAKE_MPS2 + 0.5 * (speed_mps - wanted_mps))
        accel_mps2 = min(ACCEL_MPS2, wanted_mps - speed_mps)
        return self._commands(self._mass_kg * accel_mps2, 0.0)

    def _commands(self, force_n: float, brake_mps2: float) -> list[Frame]:
        return [
            BrakeCommand(
                service_decel_mps2=min(1.0, brake_mps2),
                emergency_released=True,
                holding_released=True,
            ),
            TractionCommand(
                force_n=force_n, direction=Direction.FORWARD, traction_permitted=force_n > 0.0
            ),
            DoorCommand(enable_left=False, enable_right=False, open_left=False, open_right=False),
        ]

    def _braked(self) -> list[Frame]:
        """Service brake and holding brake; the emergency brake stays released."""
        return [
            BrakeCommand(service_decel_mps2=1.0, emergency_released=True, holding_released=False),
            TractionCommand(force_n=0.0, direction=Direction.NEUTRAL, traction_permitted=False),
            DoorCommand(enable_left=False, enable_right=False, open_left=False, open_right=False),
        ]


def main() -> None:
    """Answer each line of the bench with one line."""
    decoder, encoder = Decoder([Tacho, Doppler]), Encoder()
    latest: dict[type, Any] = {}
    for line in sys.stdin:
        message = json.loads(line)
        if message["type"] == "hello":
            told = message["told"]
            controller = MyController(told["line"], told["params"], told["mission"])
            answer(type="ready", version=1, name="mine 0.1", next_wakeup_ns=told["start_ns"])
            continue
        now_ns = message["now_ns"]
        frames: list[list[object]] = []
        if message["type"] == "grant":
            for stamp_ns, can_id, data in message.get("frames", ()):
                # What cannot be trusted comes back as a `Rejected` and is left out here.
                frame = decoder.decode(can_id, bytes.fromhex(data), stamp_ns)
                latest[type(frame)] = frame
            for command in controller.step(latest.get(Tacho), latest.get(Doppler)):
                frames += [[can_id, data.hex()] for can_id, data in encoder.encode(command)]
        answer(type="yield", now_ns=now_ns, next_wakeup_ns=now_ns + CYCLE_NS, frames=frames)


def answer(**members: object) -> None:
    """Write one message to the bench. Anything else printed there would break the protocol."""
    print(json.dumps(members), flush=True)


if __name__ == "__main__":
    main()
