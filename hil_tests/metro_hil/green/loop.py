"""The loop over all steps of a simulated line, with its books; only numbers, compiled like `kernel`."""

from typing import Any, Final

from metro_hil.green.kernel import (
    AUXILIARIES,
    EFFORT,
    FRICTION,
    HIGHEST_V,
    LEG,
    LINES,
    LOWEST_V,
    RECTIFIERS,
    REGAINED,
    REGENERATED,
    RESISTOR,
    SOURCES,
    SPEED,
    STANDS,
    STATIONS,
    TRACTION,
    UNCONVERGED,
    VOLTAGE,
    WAY,
    WHEEL,
    decide_n,
    demand,
    move,
    work_at_station,
)
from plant_emulator.power import flow
from plant_emulator.power.compiled import kernel
from plant_emulator.power.network import arrange

RECORDED: Final = 6
"""For each train: place, speed, voltage, net current, regenerated power, resistor power."""


@kernel
def book_network(
    n: int, parent: Any, siemens: Any, sources: Any, volts: Any, limits: Any, step_s: float,
    books: Any, powers: Any,
) -> None:
    """What substations gave and what was lost on the way; `powers` (n,) of the substations."""
    for i in range(n):
        powers[i] = 0.0
        if sources[i, 1] > 0.0:
            fed, _ = flow.source_current(volts[i], sources[i, 0], sources[i, 1], limits)
            current = fed + flow.IDLE_S * volts[i]
            powers[i] = sources[i, 0] * current
            books[SOURCES] += step_s * powers[i]
            books[RECTIFIERS] += step_s * (sources[i, 0] - volts[i]) * current
            books[STATIONS] += step_s * flow.IDLE_S * volts[i] * volts[i]
        if parent[i] >= 0:
            fall = volts[i] - volts[parent[i]]
            books[LINES] += step_s * siemens[i] * fall * fall


@kernel
def place_trains(states: Any, starts: Any, signs: Any, lengths: Any, place: Any, section: Any, edges: Any) -> None:
    """Chainage of each train and the section that holds it."""
    for i in range(len(states)):
        leg = int(states[i, LEG])
        at = starts[leg] + signs[leg] * min(states[i, WAY], lengths[leg])
        place[i] = at
        k = 0
        while k < len(edges) - 2 and at > edges[k + 1]:
            k += 1
        section[i] = k


@kernel
def book_train(
    i: int, state: Any, train: Any, load: Any, power: Any, limits: Any, step_s: float, books: Any,
) -> float:
    """One train's step in the books; answers with the share of traction that the voltage leaves."""
    share, _ = flow.effort_share(state[VOLTAGE], limits)
    chopped, _ = flow.chopped_share(state[VOLTAGE], limits)
    books[TRACTION] += step_s * load[0] * share
    books[WHEEL] += step_s * power[0] * share
    books[REGENERATED] += step_s * load[1]
    books[RESISTOR] += step_s * load[1] * chopped
    books[AUXILIARIES] += step_s * load[2]
    books[REGAINED] += step_s * power[1]
    books[FRICTION] += step_s * power[2]
    books[LOWEST_V] = min(books[LOWEST_V], state[VOLTAGE])
    books[HIGHEST_V] = max(books[HIGHEST_V], state[VOLTAGE])
    return share


@kernel
def run_line(
    step_s: float, steps: int, warm: int, states: Any, train: Any, law: Any, timetable: Any,
    dwells: Any, legs: Any, net: Any, books: Any, late: Any, every: int, record: Any, given: Any,
) -> None:
    """All steps. `legs` (5, 6): start, sign, length, hold speed, coasting point of each leg.

    `net`: order, joints, spans, resistances, sources by joint, limits, edges of sections, roots.
    `record` (rows, trains, RECORDED) and `given` (rows, joints) get each `every`-th step; 0: none.
    """
    order, joints_of, spans, ohms, joint_sources, limits, edges, roots, room = net
    (parent, siemens, of_train, of_joint, sorted_trains, section, place, sources, loads, volts,
     work, joint_volts, powers, wheel) = room
    trains, joints = len(states), len(joint_sources)
    for step in range(steps):
        now_s = step * step_s
        counts = 1.0 if step >= warm else 0.0
        for i in range(trains):
            work_at_station(now_s, states[i], i, timetable, dwells, legs[2], books, counts, late)
        place_trains(states, legs[0], legs[1], legs[2], place, section, edges)
        for j in range(joints):
            of_joint[j] = -1
        for j in roots:
            of_joint[j] = -2
        n = arrange(order, joints_of, spans, ohms, section, place, parent, siemens, of_train,
                    of_joint, sorted_trains)
        for i in range(n):
            sources[i, 0], sources[i, 1] = 0.0, 0.0
            loads[i, 0], loads[i, 1], loads[i, 2] = 0.0, 0.0, 0.0
        for j in range(joints):
            k = of_joint[j]
            sources[k, 0], sources[k, 1] = joint_sources[j, 0], joint_sources[j, 1]
            volts[k] = joint_volts[j]
        for i in range(trains):
            k, leg = of_train[i], int(states[i, LEG])
            effort = 0.0
            if states[i, STANDS] == 0.0:
                effort = decide_n(now_s, step_s, states[i], law, train, legs[2, leg],
                                  legs[3, leg], legs[4, leg])
            states[i, EFFORT] = effort
            demand(states[i], train, effort, step_s, loads[k], wheel[i])
            volts[k] = states[i, VOLTAGE]
        done = flow.solve(parent, siemens, sources, loads, limits, volts, work)
        if done < 0:
            books[UNCONVERGED] += 1.0
        for j in range(joints):
            joint_volts[j] = volts[of_joint[j]]
        if counts > 0.0:
            book_network(n, parent, siemens, sources, volts, limits, step_s, books, powers)
        for i in range(trains):
            k = of_train[i]
            states[i, VOLTAGE] = volts[k]
            share, _ = flow.effort_share(volts[k], limits)
            if counts > 0.0:
                share = book_train(i, states[i], train, loads[k], wheel[i], limits, step_s, books)
            if states[i, STANDS] == 0.0:
                move(states[i], train, share, wheel[i], step_s, books, counts)
        if every > 0 and step % every == 0:
            row = step // every
            for i in range(trains):
                keep(record[row, i], states[i], place[i], loads[of_train[i]], limits)
            if counts > 0.0:
                for j in range(joints):
                    given[row, j] = powers[of_joint[j]]


@kernel
def keep(row: Any, state: Any, place: float, load: Any, limits: Any) -> None:
    """One train's line of the record."""
    volts = state[VOLTAGE]
    power, _ = flow.load_power(volts, load[0], load[1], load[2], limits)
    chopped, _ = flow.chopped_share(volts, limits)
    row[0], row[1], row[2] = place, state[SPEED], volts
    row[3], row[4], row[5] = power / volts, load[1], load[1] * chopped
