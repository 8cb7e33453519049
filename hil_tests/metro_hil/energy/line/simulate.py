"""Runs one simulated line: prepares the arrays for the loop and evaluates its results."""

import itertools
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from metro_hil.energy.line import kernel, loop
from metro_hil.energy.line.model import (
    DWELL_S,
    DWELL_SPREAD_S,
    HEADWAY_S,
    LAP_S,
    LEGS,
    STOPS_M,
    TRAINS,
    TURNBACK_MIN_S,
    Law,
    LineTrain,
    Numbers,
    Supply,
    Timetable,
    edges_m,
)
from plant_emulator.power import flow
from plant_emulator.power.box import J_PER_KWH

STEP_S = 0.2
JOINTS_MAX = 16


@dataclass(frozen=True, slots=True)
class LineSeries:
    """Arrays (rows, trains); `given_w` (rows, substations)."""

    time_s: Numbers
    place_m: Numbers
    speed_mps: Numbers
    voltage_v: Numbers
    current_a: Numbers
    regenerated_w: Numbers
    resistor_w: Numbers
    given_w: Numbers


@dataclass(frozen=True, slots=True)
class LapResults:
    """Results of the laps that count."""

    books: Numbers = field(repr=False)
    late_s: Numbers = field(repr=False)
    """Mean lateness of each leg, (6,)."""
    laps: int
    step_s: float
    record: LineSeries | None = None

    @property
    def actual_kwh(self) -> float:
        """Energy that substations take from the grid, including the trains' auxiliaries."""
        return float(self.books[kernel.SOURCES]) / J_PER_KWH / self.laps

    @property
    def used_kwh(self) -> float:
        """Regenerated energy that other trains or auxiliaries used."""
        used_j = self.books[kernel.REGENERATED] - self.books[kernel.RESISTOR]
        return float(used_j) / J_PER_KWH / self.laps

    @property
    def burnt_kwh(self) -> float:
        """Regenerated energy that braking resistors took."""
        return float(self.books[kernel.RESISTOR]) / J_PER_KWH / self.laps

    @property
    def traction_kwh(self) -> float:
        return float(self.books[kernel.TRACTION]) / J_PER_KWH / self.laps

    @property
    def overall_kwh(self) -> float:
        """Actual energy plus the used regenerated energy: the demand without regeneration."""
        return self.actual_kwh + self.used_kwh

    @property
    def use_ratio(self) -> float:
        """Used regenerated energy relative to traction energy."""
        return self.used_kwh / self.traction_kwh

    @property
    def on_time_ratio(self) -> float:
        return float(self.books[kernel.ON_TIME] / max(1.0, self.books[kernel.RUNS]))

    @property
    def worst_s(self) -> float:
        return float(self.books[kernel.WORST_S])

    @property
    def early_s(self) -> float:
        return float(self.books[kernel.EARLY_S])

    @property
    def parking_m(self) -> float:
        """Greatest stopping error."""
        return float(self.books[kernel.WORST_M])

    @property
    def parked_ratio(self) -> float:
        """Share of the stops with an error of at most 0.3 m."""
        return float(self.books[kernel.PARKED] / max(1.0, self.books[kernel.RUNS]))

    @property
    def jerk_mps3(self) -> float:
        """Greatest change of acceleration over time, from 1 m/s on."""
        return float(self.books[kernel.WORST_JERK])

    @property
    def unconverged(self) -> int:
        return int(self.books[kernel.UNCONVERGED])

    @property
    def closure_ratio(self) -> float:
        """Relative difference between the energy of the sources and all uses and losses."""
        books = self.books
        converters_j = books[kernel.TRACTION] - books[kernel.WHEEL]
        converters_j += books[kernel.REGAINED] - books[kernel.REGENERATED]
        became_j = (
            books[kernel.RECTIFIERS] + books[kernel.STATIONS] + books[kernel.LINES]
        ) + books[kernel.RESISTOR]
        became_j += converters_j + books[kernel.AUXILIARIES] + books[kernel.FRICTION]
        became_j += books[kernel.DRAG] + books[kernel.KINETIC]
        return float((books[kernel.SOURCES] - became_j) / books[kernel.SOURCES])


def dwells_of(seed: int, laps: int, *, spread_s: float = DWELL_SPREAD_S) -> Numbers:
    """Return uniform dwells of 20 to 40 s, (laps, trains, 4); equal for all laws of one seed."""
    generator = np.random.default_rng(seed)
    return DWELL_S + spread_s * (2.0 * generator.random((laps, TRAINS, 4)) - 1.0)


def simulate(
    train: LineTrain,
    supply: Supply,
    timetable: Timetable,
    law: Law,
    dwells: Numbers,
    *,
    laps: int = 1,
    step_s: float = STEP_S,
    record_s: float = 0.0,
) -> LapResults:
    """Simulate one lap that fills the line, then `laps` that count; `record_s` > 0 records them."""
    warm, steps = round(LAP_S / step_s), round((1 + laps) * LAP_S / step_s)
    every = max(1, round(record_s / step_s)) if record_s > 0.0 else 0
    rows = steps // every + 1 if every else 1
    books, late = np.zeros(kernel.BOOKS), np.zeros(LEGS)
    books[kernel.LOWEST_V] = supply.no_load_v
    record = np.zeros((rows, TRAINS, loop.RECORDED))
    given = np.zeros((rows, len(supply.network().joints)))
    loop.run_line(
        np.array([step_s, float(steps), float(warm), float(every)]),
        _states(supply),
        train_array(train),
        law.as_array(),
        (_timetable(timetable), dwells, legs_of(timetable)),
        _net(supply),
        _room(supply),
        (books, late, record, given),
    )
    kept = None
    if every:
        time_s = np.linspace(0.0, (rows - 1) * every * step_s, rows)
        place_m, speed_mps, voltage_v, current_a, gives_w, burns_w = (
            record[:, :, part] for part in range(loop.RECORDED)
        )
        kept = LineSeries(time_s, place_m, speed_mps, voltage_v, current_a, gives_w, burns_w, given)
    per_leg = np.maximum(1.0, books[kernel.RUNS] / LEGS)
    return LapResults(books, late / per_leg, laps, step_s, kept)


def first_minutes(supply: Supply, *, step_s: float = 0.5, steps: int = 500) -> Numbers:
    """Return the account of a line that fills: a short run to compare machines.

    The law is Green CBTC with weights of one half.
    """
    books = np.zeros(kernel.BOOKS)
    timetable, nothing = Timetable(), np.zeros((1, TRAINS, loop.RECORDED))
    loop.run_line(
        np.array([step_s, float(steps), float(steps // 5), 0.0]),
        _states(supply),
        train_array(LineTrain()),
        Law("half", alpha_ratio=0.5, beta_ratio=0.5).as_array(),
        (_timetable(timetable), dwells_of(1, 2), legs_of(timetable)),
        _net(supply),
        _room(supply),
        (books, np.zeros(LEGS), nothing, np.zeros((1, len(supply.network().joints)))),
    )
    return books


def _states(supply: Supply) -> Numbers:
    states = np.zeros((TRAINS, kernel.STATE))
    states[:, kernel.STANDS] = 1.0
    states[:, kernel.LEAVES] = np.arange(TRAINS) * HEADWAY_S
    states[:, kernel.VOLTAGE] = supply.no_load_v
    return states


def train_array(train: LineTrain) -> Numbers:
    """Return the values in the order of `kernel`'s indices."""
    return np.array(
        [
            *(train.mass_kg, train.traction_force_n, train.traction_power_w),
            *(train.brake_force_n, train.brake_power_w, train.traction_efficiency_ratio),
            *(train.regeneration_efficiency_ratio, train.auxiliary_w, train.speed_max_mps),
            *(train.jerk_mps3, train.decel_mps2),
            *train.resistance_coefficients_n(),
        ]
    )


def _timetable(timetable: Timetable) -> Numbers:
    fixed = (HEADWAY_S, timetable.phase_s, LAP_S, TURNBACK_MIN_S)
    return np.array([*fixed, *timetable.runs_s])


def legs_of(timetable: Timetable) -> Numbers:
    """Return start, sign, length, hold speed and coasting point of each leg, (5, 6)."""
    there = list(itertools.pairwise(STOPS_M))
    back = [(far, near) for near, far in reversed(there)]
    legs = np.zeros((5, LEGS))
    for leg, (from_m, to_m) in enumerate(there + back):
        legs[0, leg], legs[1, leg] = from_m, 1.0 if to_m > from_m else -1.0
        legs[2, leg] = abs(to_m - from_m)
    legs[3], legs[4] = timetable.hold_mps, timetable.coast_m
    return legs


def _net(supply: Supply) -> tuple[Any, ...]:
    network = supply.network()
    return (
        np.array(network.order),
        np.array(network.joints_of),
        np.array(network.spans_m),
        np.array(network.ohms_per_m),
        np.array(network.sources),
        np.array(network.limits),
        np.array(edges_m(supply)),
        np.array(network.roots),
    )


def _room(supply: Supply) -> tuple[Any, ...]:
    joints = len(supply.network().joints)
    nodes = TRAINS + joints
    whole, sources = np.int64, np.zeros((flow.SOURCE_ROWS, nodes))
    return (
        *(np.zeros(nodes, dtype=whole), np.zeros(nodes), np.zeros(TRAINS, dtype=whole)),
        *(np.zeros(joints, dtype=whole), np.zeros(TRAINS, dtype=whole)),
        *(np.zeros(TRAINS, dtype=whole), np.zeros(TRAINS), sources),
        *(np.zeros((3, nodes)), np.zeros(nodes), np.zeros((4, nodes))),
        *(np.full(joints, supply.no_load_v), np.zeros(nodes), np.zeros((TRAINS, 5))),
    )
