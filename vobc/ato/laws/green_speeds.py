"""The target speeds of Green CBTC ([Lin], equations 3 to 12) as plain functions of numbers.

No function calls another, none needs more than `math`, and none has keyword-only arguments. They
drive the train here and can also be compiled as they are for simulations of a line.
"""

import math


def arm_current_a(
    voltage_v: float,
    standard_v: float,
    feed_factor: float,
    arm_ohm: float,
    train_count: float,
    exponent: float,
) -> float:
    """I_k, equation (8): current of the supply section that corresponds to the voltage.

    Args:
        feed_factor: p, 4 for bilateral feed and 2 for unilateral.
        arm_ohm: L * r of feeder and return.
        train_count: m, number of trains in the section.
        exponent: q. 1 agrees with a resistor ladder for both kinds of feed; the paper prints 2 for
            unilateral feed, which is 12 to 20 % too high.
    """
    spread = 1.0 + 1.0 / math.pow(train_count, exponent)
    return (standard_v - voltage_v) * feed_factor / (arm_ohm * spread)


def energy_speed_mps(
    speed_mps: float,
    mass_kg: float,
    voltage_v: float,
    current_a: float,
    standard_w: float,
    horizon_s: float,
) -> float:
    """V_energy, equations (9) to (11).

    (9) is a power and (10) needs an energy, so it is multiplied by a horizon, 1 s as printed. A low
    voltage slows the train down, a high one speeds it up.

    Args:
        standard_w: U_s * I_s, 0 for a reference without load.
    """
    change_j = (standard_w - voltage_v * current_a) * horizon_s
    return math.sqrt(max(0.0, speed_mps * speed_mps + 2.0 * change_j / mass_kg))


def literal_timing_speed_mps(left_m: float, left_s: float, decel_mps2: float) -> float:
    """V_time as printed, equations (3) to (7): the distance before parking over the remaining time.

    The braking point assumes a train at the mean speed.
    """
    if left_m <= 0.0 or left_s <= 0.0:
        return math.inf
    speed = left_m / left_s
    for _ in range(3):
        park_m = speed * speed / (2.0 * decel_mps2)
        park_s = math.sqrt(2.0 * park_m / decel_mps2)
        if left_m <= park_m or left_s <= park_s:
            return math.inf
        speed = (left_m - park_m) / (left_s - park_s)
    return speed


def timing_speed_mps(
    left_m: float, left_s: float, speed_mps: float, accel_mps2: float, decel_mps2: float
) -> float:
    """V_time with the time to accelerate and brake, which (7) omits. inf: too late.

    The train accelerates at a from the present speed v to V, runs on at V, and brakes at b to a
    stand: left_m = V * left_s - (V - v)² / 2a - V² / 2b. The result is the smaller root. For a
    train that is already faster, the term of a is omitted.
    """
    if left_m <= 0.0 or left_s <= 0.0:
        return math.inf
    square = 1.0 / (2.0 * decel_mps2)
    root = left_s * left_s - 4.0 * square * left_m
    if root >= 0.0:
        steady = (left_s - math.sqrt(root)) / (2.0 * square)
        if steady <= speed_mps:
            return steady
    square += 1.0 / (2.0 * accel_mps2)
    linear = left_s + speed_mps / accel_mps2
    constant = left_m + speed_mps * speed_mps / (2.0 * accel_mps2)
    root = linear * linear - 4.0 * square * constant
    if root < 0.0:
        return math.inf
    return (linear - math.sqrt(root)) / (2.0 * square)


def target_speed_mps(
    top_mps: float, timing_mps: float, energy_mps: float, alpha_ratio: float, beta_ratio: float
) -> float:
    """V_target, equation (12), with each speed limited to V_top first.

    As printed, V_energy >= V_top forces V_top even with beta = 0. Here it counts by its weight.
    """
    timing = min(timing_mps, top_mps)
    if timing >= top_mps or beta_ratio <= 0.0:
        return timing
    return min(top_mps, alpha_ratio * timing + beta_ratio * min(energy_mps, top_mps))
