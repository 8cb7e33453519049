"""A controller that moves the train 100 m at 18 km/h and stops, in Python.

The bench starts this program and speaks JSON with it, a line for each message. The frames are coded
by `can_dbc`, so counters, CRCs and inverted twins are right. There is no ATP in here: it shows
how to connect a controller, not how to build one.
"""

import json
import math
import sys

from can_dbc.brake import BrakeCommand
from can_dbc.codec import Decoder, Encoder, Rejected
from can_dbc.nodes import Direction
from can_dbc.odometer import Tacho
from can_dbc.traction import TractionCommand

CYCLE_NS = 50_000_000
TARGET_M = 100.0
CRUISE_MPS = 5.0
ACCEL_MPS2 = 0.5
BRAKE_MPS2 = 0.4
STANDING_MPS = 0.05
GAIN_PER_S = 1.0


class Shunter:
    def __init__(self, train: dict) -> None:
        self.m_per_pulse = math.pi * train["wheel_diameter_m"] / train["pulses_per_turn"]
        self.mass_kg = train["tare_kg"] + 0.5 * train["full_load_kg"]
        self.encoder, self.decoder = Encoder(), Decoder((Tacho,))
        self.pulses = None
        self.distance_m = self.speed_mps = 0.0
        self.moved = False

    def cycle(self, now_ns: int, frames: list) -> list:
        for at_ns, can_id, data in frames:
            received = self.decoder.decode(can_id, bytes.fromhex(data), at_ns)
            if received is not None and not isinstance(received, Rejected):
                self.take(received)
        accel_mps2 = self.demand_mps2()
        return [
            *self.encoder.encode(
                BrakeCommand(
                    service_decel_mps2=max(0.0, -accel_mps2),
                    emergency_released=True,
                    holding_released=accel_mps2 > 0.0 or self.speed_mps > STANDING_MPS,
                )
            ),
            *self.encoder.encode(
                TractionCommand(
                    force_n=max(0.0, accel_mps2) * self.mass_kg,
                    direction=Direction.FORWARD,
                    traction_permitted=accel_mps2 > 0.0,
                )
            ),
        ]

    def take(self, tacho: Tacho) -> None:
        if self.pulses is not None:
            # The counter is 16 bits wide; the half range is far more than a train moves in 50 ms.
            moved = (tacho.pulses_a - self.pulses + 32768) % 65536 - 32768
            self.distance_m += moved * self.m_per_pulse
            self.speed_mps += 0.3 * (moved * self.m_per_pulse / 0.02 - self.speed_mps)
        self.pulses = tacho.pulses_a

    def demand_mps2(self) -> float:
        left_m = max(0.0, TARGET_M - self.distance_m)
        wanted_mps = min(CRUISE_MPS, math.sqrt(2.0 * BRAKE_MPS2 * left_m))
        if left_m < 0.3:
            return -1.0
        return max(-1.0, min(ACCEL_MPS2, GAIN_PER_S * (wanted_mps - self.speed_mps)))


def send(kind: str, **members: object) -> None:
    print(json.dumps({"type": kind, **members}), flush=True)


def main() -> None:
    shunter = None
    for line in sys.stdin:
        message = json.loads(line)
        if message["type"] == "hello":
            shunter = Shunter(message["told"]["params"]["train"])
            start_ns = message["told"]["start_ns"]
            send("ready", version=1, name="shunter 1.0", next_wakeup_ns=start_ns)
            continue
        now_ns = message["now_ns"]
        sent = shunter.cycle(now_ns, message.get("frames", []))
        frames = [[can_id, data.hex()] for can_id, data in sent]
        send("yield", now_ns=now_ns, next_wakeup_ns=now_ns + CYCLE_NS, frames=frames)


if __name__ == "__main__":
    main()
