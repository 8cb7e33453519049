"""Runs by chance: pairs and triples of faults at conditions, each on a line of its own."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import tomli_w

from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb import load_line
from vobc.config import load_config
from vobc.plausible import implausible

FILE: Final = "attack.toml"
LINES: Final = "lines"
VACUOUS: Final = (
    "places, windows and faults are by chance, so a fault may meet nothing, and an invariant may "
    "judge nothing; each counts only where it judged"
)
Table = dict[str, Any]

TRAINS: Final = ("florence4", "hefei6", "nanakuma4", "typeB4")
DRIVERS: Final = (None, None, "late", "reckless")
"""Drivers by chance; None: operation drives."""
STEEPEST_PERMILLE: Final = (60.0, 45.0, 30.0, 20.0, 10.0, 0.0)
"""Steepest gradient of a line. The first with which line and train fit each other is taken."""
LIMITS_MPS: Final = (6.0, 19.0)
PIECES_M: Final = (1.0, 200.0)
HOP_M: Final = (350.0, 700.0)
STARTS_M: Final = (-900.0, 2000.0)
DURATION_S: Final = 150.0
CLEAR_M: Final = 30.0
"""Distance from its first stop at which a train has surely set off."""
BALISES_M: Final = 120.0
STOP_TAGS: Final = (("t1", 52.0), ("t2", 12.0), ("t3", 3.5), ("stop", 2.0))
"""Tags before a stopping point, with their distances, as docs/guide/my_line.md asks for."""
ROLLBACK_M: Final = 4.0

POOL: Final[Mapping[str, Sequence[Table]]] = {
    "bus": (
        {"kind": "frame_drop", "loss_ratio": 0.5},
        {"kind": "frame_delay", "delay_s": 0.06, "jitter_s": 0.04},
        {"kind": "frame_duplicate", "copies": 2},
        {"kind": "frame_reorder"},
        {"kind": "frame_replay", "frames": "*_CMD*"},
        {"kind": "frame_corrupt", "damage": "after_crc", "frames": "[BDV]*"},
        {"kind": "masquerade", "frame": "BRAKE_CMD"},
        {"kind": "babbling_idiot", "can_id": 0},
        {"kind": "bus_off", "node": "vobc"},
        {"kind": "link_cut", "node": "bcu"},
    ),
    "odometry": (
        {"kind": "wheel_slip", "slip_ratio": 0.2, "ramp_s": 0.3},
        {"kind": "wheel_slide", "slide_ratio": 0.3, "ramp_s": 0.3},
        {"kind": "low_adhesion", "adhesion_ratio": 0.08},
        {"kind": "tacho_stuck"},
        {"kind": "tacho_unhealthy"},
        {"kind": "doppler_outage"},
        {"kind": "doppler_wrong", "error_ratio": 0.1},
        {"kind": "imu_bias"},
        {"kind": "sensor_restart"},
    ),
    "tags": (
        {"kind": "tag_missed"},
        {"kind": "antenna_dead"},
        {"kind": "telegram_torn", "share_ratio": 0.5},
        {"kind": "telegram_delay", "delay_s": 0.1},
        {"kind": "serial_cut"},
    ),
    "brake": (
        {"kind": "brake_late", "delay_s": 0.5},
        {"kind": "brake_weak", "gain_ratio": 0.0},
        {"kind": "brake_stuck"},
        {"kind": "emergency_late", "delay_s": 0.3},
        {"kind": "holding_late", "delay_s": 2.0},
    ),
    "traction": (
        {"kind": "traction_runaway", "accel_mps2": 1.0},
        {"kind": "traction_weak", "gain_ratio": 0.5},
        {"kind": "traction_late", "delay_s": 0.5},
        {"kind": "line_voltage", "voltage_v": 480.0},
        {"kind": "breaker_open"},
    ),
    "people": (
        {"kind": "door_lock_lost"},
        {"kind": "passenger_alarm"},
        {"kind": "emergency_button"},
        {"kind": "desk_reset"},
        {"kind": "desk_mode", "mode": "off"},
        {"kind": "desk_lever", "lever_percent": 100.0},
    ),
    "radio": (
        {"kind": "radio_loss", "loss_ratio": 0.5},
        {"kind": "radio_delay", "delay_s": 0.5, "jitter_s": 0.5},
        {"kind": "radio_reorder"},
        {"kind": "radio_partition"},
        {"kind": "authority_withdrawn"},
        {"kind": "centre_silent"},
        {"kind": "doors_not_authorised"},
    ),
    "controller": (
        {"kind": "controller_killed"},
        {"kind": "controller_paused"},
        {"kind": "slow_cycle", "extra_s": 0.2},
        {"kind": "clock_step", "step_s": 0.5},
    ),
}
"""Faults within what the parameters declare. A run has at most one of each group, because two
failed sensors of odometry at a time, for example, are beyond the assumptions."""


def write_attack(folder: Path, seed: int, runs: int) -> Path:
    """Write the lines and a campaign file of so many scenarios. Raises OSError.

    Run K of a seed S is the first one of the seed S + K.
    """
    (folder / LINES).mkdir(parents=True, exist_ok=True)
    scenarios = [_scenario(folder, each) for each in range(seed, seed + runs)]
    path = folder / FILE
    document = {
        "title": "Pairs and triples of faults at conditions, on lines by chance",
        "vacuous": {"allowed": ["faults", "requirements"], "reason": VACUOUS},
        "scenario": scenarios,
    }
    write_whole(path, tomli_w.dumps(document))
    return path


def _scenario(folder: Path, seed: int) -> Table:
    chance = np.random.default_rng(seed)
    train = TRAINS[int(chance.integers(0, len(TRAINS)))]
    name = f"{LINES}/{seed}.toml"
    start_m, stop_m = _write_line(folder / name, chance, train)
    driver = DRIVERS[int(chance.integers(0, len(DRIVERS)))]
    groups = chance.permutation(len(POOL))[: int(chance.integers(2, 4))]
    names = [list(POOL)[int(each)] for each in groups]
    settings: Table = {
        "line": name,
        "consist": train,
        "params": train,
        "load_ratio": round(float(chance.uniform(0.0, 1.0)), 3),
        "duration_s": DURATION_S,
    }
    if driver is not None:
        settings |= {"desk_mode": "manual", "driver": driver}
    return {
        "name": f"attack-{seed}",
        "seed_base": seed,
        "train": settings,
        "fault": [_fault(chance, group, start_m, stop_m) for group in names],
    }


def _fault(chance: np.random.Generator, group: str, start_m: float, stop_m: float) -> Table:
    """A fault of the group with a condition, and a duration or none."""
    pool = POOL[group]
    table = dict(pool[int(chance.integers(0, len(pool)))])
    front_m = round(start_m + 1.0 + float(chance.uniform(0.0, 0.7)) * (stop_m - start_m), 1)
    conditions = (
        f"front_m > {front_m}",
        f"front_m > {front_m}",
        f"speed_mps > {round(float(chance.uniform(1.0, 6.0)), 1)}",
        # At the first platform, the distance to the stop is zero.
        f"front_m > {start_m + CLEAR_M} and "
        f"to_stop_m < {round(float(chance.uniform(10.0, 150.0)), 1)}",
        'ato_phase == "running" and speed_mps > 1.0',
        f'front_m > {front_m} and supervision == "nominal"',
    )
    table["when"] = conditions[int(chance.integers(0, len(conditions)))]
    table["duration_s"] = round(float(np.exp(chance.uniform(np.log(0.2), np.log(20.0)))), 2)
    return table


def _write_line(path: Path, chance: np.random.Generator, train: str) -> tuple[float, float]:
    """Write a line of one hop that fits the train; return where the hop begins and ends."""
    config = load_config(train)
    begin_m = float(round(chance.uniform(*STARTS_M)))
    length_m = config.train.length_m
    start_m = begin_m + length_m + 20.0
    stop_m = start_m + float(round(chance.uniform(*HOP_M)))
    end_m = stop_m + 300.0
    limits = pieces(chance, begin_m, end_m, LIMITS_MPS)
    gradients = pieces(chance, begin_m, end_m, (-1.0, 1.0))
    for steepest_permille in STEEPEST_PERMILLE:
        document = {
            "name": path.stem,
            "description": "By chance, for an attack",
            "start_m": begin_m,
            "end_m": end_m,
            "rollback_m": ROLLBACK_M,
            "stations": [
                _station("A", start_m, length_m),
                _station("B", stop_m, length_m),
            ],
            "speed_sections": [
                {"start_m": at_m, "end_m": to_m, "limit_mps": value} for at_m, to_m, value in limits
            ],
            "gradients": [
                {
                    "start_m": at_m,
                    "end_m": to_m,
                    "gradient_permille": round(steepest_permille * value, 2),
                }
                for at_m, to_m, value in gradients
            ],
            "tags": _tags(start_m, stop_m),
        }
        write_whole(path, tomli_w.dumps(document))
        if not implausible(config, load_line(str(path))):
            return start_m, stop_m
    raise AssertionError(f"{path}: a level line does not fit the train {train}")


def _station(name: str, stop_m: float, length_m: float) -> Table:
    return {
        "name": name,
        "stop_m": stop_m,
        "platform_start_m": stop_m - length_m - 10.0,
        "platform_end_m": stop_m + 5.0,
        "dwell_s": 10.0,
    }


def _tags(start_m: float, stop_m: float) -> list[Table]:
    """A balise at least every 120 m, and the tags of the stop at the end of the hop."""
    first_m, last_m = start_m + 20.0, stop_m - STOP_TAGS[0][1] - 10.0
    count = max(2, round((last_m - first_m) / BALISES_M) + 1)
    tags: list[Table] = [
        {
            "tag_id": 100 + index,
            "position_m": round(first_m + (last_m - first_m) * index / (count - 1), 1),
            "kind": "balise",
        }
        for index in range(count)
    ]
    for index, (kind, before_m) in enumerate(STOP_TAGS):
        tags.append(
            {
                "tag_id": 200 + index,
                "position_m": stop_m - before_m,
                "kind": kind,
                "station": "B",
            }
        )
    return tags


def pieces(
    chance: np.random.Generator,
    begin_m: float,
    end_m: float,
    values: tuple[float, float],
    *,
    least_m: float = PIECES_M[0],
) -> list[tuple[float, float, float]]:
    """Sections from end to end, with lengths of one order of magnitude."""
    longest_m = float(np.exp(chance.uniform(np.log(2.0 * least_m), np.log(PIECES_M[1]))))
    found: list[tuple[float, float, float]] = []
    at_m = begin_m
    while at_m < end_m:
        to_m = min(end_m, round(at_m + float(chance.uniform(least_m, longest_m)), 1))
        found.append((at_m, to_m, round(float(chance.uniform(*values)), 3)))
        at_m = to_m
    return found
