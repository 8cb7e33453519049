"""Seven trains and their network, step by step, as plain numbers; compiled if numba is installed.

In each step every train decides its effort from what it knows. Powers follow from the speed in the
middle of the step; from its start they would be 0.6 to 0.8 % wrong at 0.2 s. The network is solved
with these powers, and the effort that its voltage permits moves the trains.
"""

from typing import Any, Final

import numpy as np

from metro_hil.energy.compiled import jitted, kernel
from vobc.ato.laws import green_speeds as plain_law

# State of a train.
LEG, WAY, SPEED, EFFORT, LEAVES, DUE, BRAKES, VOLTAGE, LAP, STANDS, COASTS, ACCEL = range(12)
STATE: Final = 12
# Train.
(
    MASS,
    FORCE,
    POWER,
    BRAKE_FORCE,
    BRAKE_POWER,
    TRACTION_RATIO,
    REGENERATION_RATIO,
    AUXILIARY,
    TOP,
    JERK,
    DECEL,
    DRAG_A,
    DRAG_B,
    DRAG_C,
) = range(14)
# Law.
ALPHA, BETA, HORIZON, CONSTANT_V, STANDARD_V, SIGN, LITERAL_TIME, HOLD_COAST = range(8)
# Energy account in J, except for the last entries.
(
    SOURCES,
    RECTIFIERS,
    STATIONS,
    LINES,
    TRACTION,
    AUXILIARIES,
    REGENERATED,
    RESISTOR,
    WHEEL,
    REGAINED,
    FRICTION,
    DRAG,
    KINETIC,
    UNCONVERGED,
    RUNS,
    ON_TIME,
    WORST_S,
    LOWEST_V,
    HIGHEST_V,
    EARLY_S,
    WORST_M,
    PARKED,
    WORST_JERK,
) = range(23)
BOOKS: Final = 23

GAIN_PER_S: Final = 0.6
COAST_BAND_MPS2: Final = 0.03
STOPPED_MPS: Final = 0.08
STOPPED_M: Final = 0.02
ON_TIME_S: Final = 2.0
PARKED_M: Final = 0.3
"""Stopping error up to which a stop counts as precise parking, as in [Lin]."""
JERK_FROM_MPS: Final = 1.0
"""Speed from which the jerk counts. Below it, the standstill itself would hide all others."""
FEED_FACTOR: Final = 4.0
ARM_OHM: Final = 0.04
"""Resistance of 2 km with 0.02 ohm/km; a train does not know the true values."""
ARM_TRAINS: Final = 2.0
LOST_S: Final = 0.2
"""Time lost through the jerk limit at both ends of a run."""
RUN_MAX_S: Final = 900.0

green_law: Final = jitted(plain_law)
arm_current_a = green_law.arm_current_a
energy_speed_mps = green_law.energy_speed_mps
timing_speed_mps = green_law.timing_speed_mps
literal_timing_speed_mps = green_law.literal_timing_speed_mps
target_speed_mps = green_law.target_speed_mps


@kernel
def wanted_mps(now_s: float, state: Any, law: Any, train: Any, left_m: float) -> float:
    """Return V_target of Green CBTC [Lin] for one train between stations."""
    speed = state[SPEED]
    left_s = state[DUE] - now_s
    if law[LITERAL_TIME] > 0.0:
        timing = literal_timing_speed_mps(left_m, left_s, train[DECEL])
    else:
        # Mean acceleration of the motors up to that speed; LOST_S is the share of the jerk limit.
        accel = min(
            train[FORCE] / train[MASS], 0.75 * train[POWER] / train[MASS] / max(speed, 12.0)
        )
        timing = timing_speed_mps(
            left_m, left_s - LOST_S, speed, accel_mps2=accel, decel_mps2=train[DECEL]
        )
    if law[BETA] <= 0.0:
        return float(min(timing, train[TOP]))
    volts = law[CONSTANT_V] if law[CONSTANT_V] > 0.0 else state[VOLTAGE]
    current = arm_current_a(
        volts,
        law[STANDARD_V],
        feed_factor=FEED_FACTOR,
        arm_ohm=ARM_OHM,
        train_count=ARM_TRAINS,
        exponent=1.0,
    )
    energy = energy_speed_mps(
        speed,
        train[MASS],
        volts,
        law[SIGN] * current,
        standard_w=0.0,
        horizon_s=law[HORIZON],
    )
    target = target_speed_mps(
        train[TOP], timing, energy, alpha_ratio=law[ALPHA], beta_ratio=law[BETA]
    )
    return float(target)


@kernel
def decide_n(now_s: float, step_s: float, state: Any, law: Any, train: Any, bounds: Any) -> float:
    """Return the effort at the wheel for the next step: positive traction, negative braking.

    `bounds` of the leg: its length, and the hold speed and coasting point of hold and coast.
    """
    length_m, hold_mps, coast_m = bounds
    speed, left_m = state[SPEED], max(0.0, length_m - state[WAY])
    mass, jerk, decel = train[MASS], train[JERK], train[DECEL]
    drag = train[DRAG_A] + speed * (train[DRAG_B] + speed * train[DRAG_C])
    change = max(0.0, state[EFFORT] / mass) + decel
    build_m = speed * change / jerk / 2.0
    if state[BRAKES] == 0.0 and speed > 1.0 and speed * speed / (2.0 * decel) >= left_m - build_m:
        state[BRAKES] = 1.0
    if state[BRAKES] > 0.0:
        asked = -min(1.3, speed * speed / (2.0 * max(left_m, STOPPED_M)))
        effort = mass * asked + drag
    elif law[HOLD_COAST] > 0.0:
        if state[WAY] >= coast_m:
            state[COASTS] = 1.0
        asked = min(1.0, GAIN_PER_S * (hold_mps - speed))
        effort = 0.0 if state[COASTS] > 0.0 else max(0.0, mass * asked + drag)
    else:
        target = wanted_mps(now_s, state, law, train, left_m)
        asked = max(-decel, min(1.0, GAIN_PER_S * (target - speed)))
        effort = mass * asked + drag
        if -COAST_BAND_MPS2 * mass < effort < 0.0:
            effort = 0.0
    most = min(train[FORCE], train[POWER] / max(speed, 0.5))
    effort = min(effort, most)
    bound = jerk * step_s * mass
    # At the end of a stop the jerk is not limited: the speed is only a few cm/s.
    if speed > 1.0 or effort > 0.0:
        effort = min(max(effort, state[EFFORT] - bound), state[EFFORT] + bound)
    return float(effort)


@kernel
def demand(state: Any, train: Any, effort: float, step_s: float, load: Any, power: Any) -> None:
    """Write the electrical demands to `load` and the state at the wheel to `power`.

    `power` gets the powers of motors, electric brake and friction brake, at the speed in the middle
    of the step. Then follow the forces of traction and brake.
    """
    speed, mass = state[SPEED], train[MASS]
    drag = train[DRAG_A] + speed * (train[DRAG_B] + speed * train[DRAG_C])
    if speed <= 0.0 and effort <= drag:
        drag = effort
    after = max(0.0, speed + step_s * (effort - drag) / mass)
    middle = 0.5 * (speed + after)
    pulls = max(0.0, effort)
    brakes = max(0.0, -effort)
    electric = min(brakes, train[BRAKE_FORCE], train[BRAKE_POWER] / max(middle, 0.5))
    # The electric brake fades out before the stop.
    electric *= min(1.0, max(0.0, (middle - 0.8) / 1.4))
    power[0] = pulls * middle
    power[1] = electric * middle
    power[2] = (brakes - electric) * middle
    power[3] = pulls
    power[4] = brakes
    load[0] = power[0] / train[TRACTION_RATIO]
    load[1] = power[1] * train[REGENERATION_RATIO]
    load[2] = train[AUXILIARY]


@kernel
def move(
    state: Any, train: Any, share: float, power: Any, step_s: float, books: Any, counts: float
) -> None:
    """Move a train by one step with the effort that the voltage permits."""
    speed, mass = state[SPEED], train[MASS]
    drag = train[DRAG_A] + speed * (train[DRAG_B] + speed * train[DRAG_C])
    effort = power[3] * share - power[4]
    if speed <= 0.0 and effort <= drag:
        return
    after = speed + step_s * (effort - drag) / mass
    part = 1.0
    if after < 0.0:
        part = speed / (speed - after)
        after = 0.0
    middle = 0.5 * (speed + after)
    state[WAY] += middle * part * step_s
    state[SPEED] = after
    accel = (after - speed) / step_s
    if counts > 0.0 and speed > JERK_FROM_MPS and after > JERK_FROM_MPS:
        books[WORST_JERK] = max(books[WORST_JERK], abs(accel - state[ACCEL]) / step_s)
    state[ACCEL] = accel
    books[DRAG] += counts * drag * middle * part * step_s
    books[KINETIC] += counts * 0.5 * mass * (after * after - speed * speed)


@kernel
def work_at_station(
    now_s: float,
    state: Any,
    train: int,
    timetable: Any,
    dwells: Any,
    lengths: Any,
    books: Any,
    counts: float,
    log: Any,
) -> None:
    """Let a train arrive, dwell and leave.

    `timetable`: headway, phase, lap, minimum dwell, and the running times from index 4 on.
    """
    if state[STANDS] > 0.0:
        if now_s >= state[LEAVES]:
            leg = int(state[LEG])
            state[STANDS], state[BRAKES], state[COASTS] = 0.0, 0.0, 0.0
            state[WAY], state[SPEED], state[EFFORT] = 0.0, 0.0, 0.0
            state[DUE] = state[LEAVES] + timetable[4 + leg]
        return
    leg = int(state[LEG])
    left_m = lengths[leg] - state[WAY]
    if state[BRAKES] == 0.0 or (state[SPEED] > STOPPED_MPS and left_m > STOPPED_M):
        return
    late_s = now_s - state[DUE]
    if counts > 0.0:
        books[RUNS] += 1.0
        if abs(late_s) <= ON_TIME_S:
            books[ON_TIME] += 1.0
        books[WORST_S] = max(books[WORST_S], abs(late_s))
        books[EARLY_S] = max(books[EARLY_S], -late_s)
        books[WORST_M] = max(books[WORST_M], abs(left_m))
        if abs(left_m) <= PARKED_M:
            books[PARKED] += 1.0
        log[leg] += late_s
    state[STANDS], state[SPEED], state[EFFORT], state[ACCEL] = 1.0, 0.0, 0.0, 0.0
    lap = int(state[LAP])
    if leg == 2:
        planned_s = train * timetable[0] + lap * timetable[2] + timetable[1]
        state[LEAVES] = max(planned_s, now_s + timetable[3])
    elif leg == 5:
        state[LAP] = lap + 1
        planned_s = train * timetable[0] + (lap + 1) * timetable[2]
        state[LEAVES] = max(planned_s, now_s + timetable[3])
    else:
        stop = leg if leg < 2 else leg - 1
        state[LEAVES] = now_s + dwells[lap % len(dwells), train, stop]
    state[LEG] = (leg + 1) % 6
    state[WAY] = 0.0


@kernel
def run_leg(step_s: float, train: Any, law: Any, bounds: Any, state: Any, power: Any) -> Any:
    """Return time, electrical traction energy and regenerated energy of one run at full voltage.

    `state` (STATE,) and `power` (5,) are working arrays.
    """
    for place in range(STATE):
        state[place] = 0.0
    state[DUE], state[VOLTAGE] = RUN_MAX_S, 800.0
    books, load, now_s = (np.zeros(BOOKS)), np.zeros(3), 0.0
    traction_j = regenerated_j = 0.0
    while now_s < RUN_MAX_S:
        left_m = bounds[0] - state[WAY]
        if state[BRAKES] > 0.0 and (state[SPEED] <= STOPPED_MPS or left_m <= STOPPED_M):
            break
        effort = decide_n(now_s, step_s, state, law, train, bounds)
        state[EFFORT] = effort
        demand(state, train, effort, step_s, load, power)
        traction_j += load[0] * step_s
        regenerated_j += load[1] * step_s
        move(state, train, 1.0, power, step_s, books, 0.0)
        now_s += step_s
        if state[COASTS] > 0.0 and state[SPEED] < 1.0 and left_m > 20.0:
            return RUN_MAX_S, traction_j, regenerated_j
    return now_s, traction_j, regenerated_j
