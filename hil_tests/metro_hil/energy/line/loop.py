"""The loop over all steps of a simulated line with its energy account; compiled like `kernel`."""

from typing import Any, Final

from metro_hil.energy.compiled import jitted, kernel
from metro_hil.energy.line.kernel import (
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
from plant_emulator.power import flow as plain_flow

flow: Final = jitted(plain_flow)
RECORDED: Final = 6
"""Values for each train: place, speed, voltage, net current, regenerated and resistor power."""


@kernel
def book_network(
    n: int,
    parent: Any,
    siemens: Any,
    sources: Any,
    volts: Any,
    limits: Any,
    step_s: float,
    books: Any,
    powers: Any,
) -> None:
    """Account the output of substations and the losses; `powers` (n,) are the substations'."""
    for i in range(n):
        powers[i] = 0.0
        if sources[flow.GIVES_OHM, i] > 0.0:
            current = flow.given_a(volts[i], i, sources, limits)
            taken = flow.taken_a(volts[i], i, sources, limits)
            gives_v, takes_v = sources[flow.GIVES_BELOW, i], sources[flow.TAKES_ABOVE, i]
            powers[i] = gives_v * current - takes_v * taken
            books[SOURCES] += step_s * powers[i]
            loss = (gives_v - volts[i]) * current + (volts[i] - takes_v) * taken
            books[RECTIFIERS] += step_s * loss
            books[STATIONS] += step_s * flow.IDLE_S * volts[i] * volts[i]
        if parent[i] >= 0:
            fall = volts[i] - volts[parent[i]]
            books[LINES] += step_s * siemens[i] * fall * fall


@kernel
def place_trains(
    states: Any, starts: Any, signs: Any, lengths: Any, place: Any, section: Any, edges: Any
) -> None:
    """Compute the chainage of each train and its section."""
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
    state: Any, share: float, load: Any, power: Any, limits: Any, step_s: float, books: Any
) -> None:
    """Account one train's step; `share` is the part of its traction that the voltage permits."""
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


@kernel
def set_nodes(states: Any, net: Any, room: Any) -> int:
    """Number the nodes with trains at their places; set sources and the last voltages."""
    order, joints_of, spans, ohms, joint_sources, _, _, roots = net
    parent, siemens, of_train, of_joint, sorted_trains, section, place, sources, loads = room[:9]
    volts, joint_volts = room[9], room[11]
    for j in range(len(of_joint)):
        of_joint[j] = -1
    for j in roots:
        of_joint[j] = -2
    n = flow.arrange(
        *(order, joints_of, spans, ohms, section, place, parent, siemens, of_train),
        *(of_joint, sorted_trains),
    )
    for i in range(n):
        sources[:, i] = 0.0
        loads[0, i], loads[1, i], loads[2, i] = 0.0, 0.0, 0.0
    for j in range(len(of_joint)):
        k = of_joint[j]
        sources[:, k] = joint_sources[:, j]
        volts[k] = joint_volts[j]
    for i in range(len(states)):
        volts[of_train[i]] = states[i, VOLTAGE]
    return int(n)


@kernel
def run_line(
    times: Any, states: Any, train: Any, law: Any, plan: Any, net: Any, room: Any, out: Any
) -> None:
    """Run all steps.

    Args:
        times: (4,) step, number of steps, first steps that do not count, steps between records (0:
            no record).
        plan: timetable, dwells, and legs (5, 6): start, sign, length, hold speed, coasting point.
        net: order, joints, spans, resistances, sources by joint, limits, edges of sections, roots.
        room: working arrays.
        out: account, lateness by leg, record (rows, trains, RECORDED), given (rows, joints).
    """
    timetable, dwells, legs = plan
    books, late, record, given = out
    of_train, of_joint, section, place = room[2], room[3], room[5], room[6]
    loads, volts, work, joint_volts, powers, wheel = room[8:]
    step_s, every, limits = times[0], int(times[3]), net[5]
    for step in range(int(times[1])):
        now_s = step * step_s
        counts = 1.0 if step >= times[2] else 0.0
        for i in range(len(states)):
            work_at_station(now_s, states[i], i, timetable, dwells, legs[2], books, counts, late)
        place_trains(states, legs[0], legs[1], legs[2], place, section, net[6])
        n = set_nodes(states, net, room)
        for i in range(len(states)):
            leg, effort = int(states[i, LEG]), 0.0
            if states[i, STANDS] == 0.0:
                bounds = (legs[2, leg], legs[3, leg], legs[4, leg])
                effort = decide_n(now_s, step_s, states[i], law, train, bounds)
            states[i, EFFORT] = effort
            demand(states[i], train, effort, step_s, loads[:, of_train[i]], wheel[i])
        if flow.solve(room[0], room[1], room[7], loads, limits, volts, work, n) < 0:
            books[UNCONVERGED] += 1.0
        for j in range(len(of_joint)):
            joint_volts[j] = volts[of_joint[j]]
        if counts > 0.0:
            book_network(n, room[0], room[1], room[7], volts, limits, step_s, books, powers)
        for i in range(len(states)):
            states[i, VOLTAGE] = volts[of_train[i]]
            share, _ = flow.effort_share(states[i, VOLTAGE], limits)
            if counts > 0.0:
                load = loads[:, of_train[i]]
                book_train(states[i], share, load, wheel[i], limits, step_s, books)
            if states[i, STANDS] == 0.0:
                move(states[i], train, share, wheel[i], step_s, books, counts)
        if every > 0 and step % every == 0:
            for i in range(len(states)):
                load = loads[:, of_train[i]]
                keep(record[step // every, i], states[i], place[i], load, limits)
            for j in range(len(of_joint)):
                given[step // every, j] = powers[of_joint[j]]


@kernel
def keep(row: Any, state: Any, place: float, load: Any, limits: Any) -> None:
    """Record one train's row."""
    volts = state[VOLTAGE]
    power, _ = flow.load_power(volts, load[0], load[1], load[2], limits)
    chopped, _ = flow.chopped_share(volts, limits)
    row[0], row[1], row[2] = place, state[SPEED], volts
    row[3], row[4], row[5] = power / volts, load[1], load[1] * chopped
