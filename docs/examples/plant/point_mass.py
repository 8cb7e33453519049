"""A train as a point mass: the smallest plant of one's own. The bench emulates everything else."""

import json
import sys


class PointMass:
    """One body with the running resistance of the consist file."""

    def __init__(self, told):
        self.train = told["train"]
        self.step_s = told["step_ns"] / 1e9
        self.front_m, self.speed_mps = told["front_m"], 0.0

    def step(self, inputs):
        """Advance by one step and return the truth at its end."""
        train, speed_mps = self.train, self.speed_mps
        slope_n = train["mass_kg"] * 9.81 * inputs["gradient_permille"] / 1000.0
        drag_n = (
            train["resistance_n_per_mps"] + train["resistance_n_per_mps2"] * abs(speed_mps)
        ) * speed_mps
        gain = self.step_s / train["inertia_kg"]
        new_mps = speed_mps + gain * (inputs["drive_n"] - slope_n - drag_n)
        # Friction removes speed; it never turns the train round.
        held_mps = gain * (
            inputs["motor_brake_n"] + inputs["trailer_brake_n"] + train["resistance_n"]
        )
        new_mps = max(0.0, new_mps - held_mps) if new_mps > 0.0 else min(0.0, new_mps + held_mps)
        self.front_m += 0.5 * (speed_mps + new_mps) * self.step_s
        self.speed_mps = new_mps
        return {
            "front_m": self.front_m,
            "speed_mps": new_mps,
            "accel_mps2": (new_mps - speed_mps) / self.step_s,
        }


def answer(kind, **members):
    print(json.dumps({"type": kind, **members}), flush=True)


train = None
for line in sys.stdin:
    message = json.loads(line)
    if message["type"] == "hello":
        if message["version"] != 1 or message.get("role") != "plant":
            answer("refuse", reason="a plant for version 1 of the protocol")
            continue
        train = PointMass(message["told"])
        answer("ready", version=1, name="point mass", provides=["motion"])
    elif message["type"] == "grant":
        answer("yield", now_ns=message["now_ns"], truth=train.step(message["inputs"]))
    else:
        answer("yield", now_ns=message["now_ns"])
