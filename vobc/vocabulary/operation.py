"""Inputs and outputs of operation."""

from dataclasses import dataclass

from can_dbc.vobc import AtoPhase


@dataclass(frozen=True, slots=True)
class AtoInput:
    """Inputs of operation. It cannot change them."""

    now_ns: int
    dt_s: float
    enabled: bool
    """The desk is in AUTO, protection is not in emergency, and nothing is missing."""
    front_m: float
    speed_mps: float
    accel_mps2: float
    standstill: bool
    accepted_tag_ids: tuple[int, ...]
    gradient_permille: float
    """Mean gradient under the train now."""
    ceiling_mps: float
    """Permitted speed. If the guaranteed emergency brake is weak, it is at most the permitted speed
    where a brake demand of now will act."""
    authority_end_m: float
    load_kg: float
    traction_ratio: float
    """Share of the rated effort that is available."""
    traction_mps2: float
    """Acceleration by this share at the present speed, before gradient and resistance."""
    doors_locked: bool
    doors_open: bool
    """The platform side is fully open."""
    door_enabled: bool
    """Protection enables the platform side now."""
    holding_applied: bool
    departure_permitted: bool = True
    """No departure inhibit applies, including the door lock."""
    skip_next: bool = False
    """Do not stop at the next station."""
    stop_next: bool = False
    """Stop at the next station, whatever the plan says, and stay."""
    stop_now: bool = False
    """Stop with the service brake wherever the train is."""
    keep_doors_open: bool = False
    """At a platform: open the doors, and leave them open."""
    jog_permitted: bool = False
    """Protection permits a jog now. It may go backwards if `jog_back_m` is positive."""
    jog_to_tag: bool = False
    """A permitted jog goes forwards, wherever the front is, to read a tag that narrows the position
    interval."""
    jog_back_m: float = 0.0
    """Distance that the train may move back. Its rear is protected that far."""
    creep: bool = False
    """Drive on sight at `ceiling_mps`. Place and authority may be unknown."""
    protection_brakes: bool = False
    """Protection applies the service brake now, whatever the demand."""
    kept_at_platform: bool = False
    """Something besides doors and authority inhibits departure, so the dwell continues."""
    ahead_m: float = 0.0
    """Greatest distance of the front beyond `front_m`. Protection uses that place."""
    slips: bool = False
    """Wheels slip or slide now. A stretched coupler does not count."""
    line_voltage_v: float | None = None
    """Voltage at the pantograph. None: the high-voltage box is silent or its breaker is open."""


@dataclass(frozen=True, slots=True)
class BrakeFinding:
    """A brake outside of what the control law expects, as measured in the present application."""

    late: bool
    """The brake acts as late as the longest expected dead time or later. Otherwise it is weak."""
    dead_time_s: float
    gain_ratio: float
    """Relative excess of the brake over the demand; negative for a weak one."""


@dataclass(frozen=True, slots=True)
class AtoDemand:
    """Demand of operation. Arbitration decides the output."""

    accel_mps2: float
    """Demand per mass for traction (positive) or service brake (negative).

    Gradient and resistance act in addition. Operation takes both into account, so that one brake
    application stays one application.
    """
    hold: bool
    """Keep or apply the holding brake."""
    open_doors: bool
    """Open the doors on the platform side of the present station."""
    phase: AtoPhase
    target_mps: float
    """Present speed of the reference."""
    distance_to_stop_m: float
    """Distance to the next stopping point. math.inf: there is none."""
    reverse: bool = False
    """Positive `accel_mps2` drives backwards. Only for a jog."""
    calls_for_help: bool = False
    """The train needs a person on site. Either all jogs are used and it is not aligned, or its
    doors stay disabled for long, or it should run and does not move."""
    stopping_at_m: float | None = None
    """Stopping point that the train approaches or stands at. None: there is none."""
    brake_finding: BrakeFinding | None = None
    """Only in the cycle that found it, once a departure at most."""
