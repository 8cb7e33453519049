"""Prints stop accuracy of the automatic operation over the Florence line, per delay kind and load.

Run it as a script: `python -m hil_tests.unit.ato_accuracy SEEDS`.
"""

import argparse
import dataclasses
import statistics
from collections.abc import Iterable

from firmware_py.trackdb import LineMap, load_line
from hil_tests.unit.ato_rig import Rig, RigSettings, Stop, served
from vobc.ato import Ato, AtoConfig

LOADS = (0.0, 0.5, 1.0)
ODOMETER_ERRORS = (-0.01, 0.0, 0.01, 0.02, 0.03, 0.04, 0.05)
DELAYS = {"fixed 1.0 s": 1.0, "drawn 0.4..1.0 s": None}


def run_line(line: LineMap, settings: RigSettings, config: AtoConfig | None = None) -> list[Stop]:
    """From chainage zero over all four stations, with short dwells."""
    stops = [
        dataclasses.replace(station, dwell_s=1.0)
        for station in line.stations
        if station.dwell_s > 0.0
    ]
    rig = Rig(Ato(config or AtoConfig(), line, 0.0, stops), line, settings, 0.0)
    rig.run(served(len(stops)))
    return rig.stops


def row(name: str, stops: Iterable[Stop]) -> str:
    stops = list(stops)
    errors = sorted(abs(stop.error_m) * 100.0 for stop in stops)
    return (
        f"{name:34} {len(errors):6d} {statistics.fmean(errors):7.2f} "
        f"{errors[int(0.99 * (len(errors) - 1))]:6.2f} {errors[-1]:6.2f} "
        f"{statistics.fmean(stop.error_m * 100.0 for stop in stops):+6.2f} "
        f"{statistics.fmean(stop.leg_s for stop in stops):7.1f} "
        f"{statistics.fmean(stop.last_50_m_s for stop in stops):7.1f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", type=int, nargs="?", default=5)
    options = parser.parse_args()
    line = load_line("florence")
    print(f"{'|error| in cm':34} {'stops':>6} {'mean':>7} {'p99':>6} {'worst':>6} "
          f"{'bias':>6} {'leg s':>7} {'50 m s':>7}")  # fmt: skip
    for name, delay_s in DELAYS.items():
        for load in LOADS:
            stops = [
                stop
                for error in ODOMETER_ERRORS
                for seed in range(options.seeds)
                for stop in run_line(
                    line,
                    RigSettings(
                        seed=seed * 7 + round(error * 100),
                        brake_delay_s=delay_s,
                        load_ratio=load,
                        odometer_error=error,
                    ),
                )
            ]
            print(row(f"{name}, load {load:.0%}", stops), flush=True)


if __name__ == "__main__":
    main()
