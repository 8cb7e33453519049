"""What operation is given and what it asks for."""

from dataclasses import dataclass

from can_dbc.vobc import AtoPhase


@dataclass(frozen=True, slots=True)
class AtoInput:
    """What operation is given. It cannot change any of it."""

    now_ns: int
    dt_s: float
    enabled: bool
    """Desk in AUTO, protection not in emergency, nothing missing."""
    front_m: float
    speed_mps: float
    accel_mps2: float
    standstill: bool
    accepted_tag_ids: tuple[int, ...]
    gradient_permille: float
    """Mean under the train now."""
    ceiling_mps: float
    authority_end_m: float
    load_kg: float
    traction_ratio: float
    """Share of the rated effort that is available."""
    traction_mps2: float
    """Acceleration that this share gives at the present speed, before gradient and resistance."""
    doors_locked: bool
    doors_open: bool
    """The platform side is fully open."""
    door_enabled: bool
    """Protection enables the platform side now."""
    holding_applied: bool
    departure_permitted: bool = True
    """Nothing of the departure interlock stands against it, the doors' own lock included."""
    skip_next: bool = False
    """Do not stop at the next station."""
    stop_next: bool = False
    """Stop at the next station, whatever the plan says, and stay."""
    stop_now: bool = False
    """Come to rest with the service brake wherever the train is."""
    keep_doors_open: bool = False
    """At a platform: open the doors, and leave them open."""
    jog_permitted: bool = False
    """Protection allows a jog now, backwards included where `jog_back_m` is more than 0."""
    jog_back_m: float = 0.0
    """How far back the train may move; its rear is protected so far."""
    creep: bool = False
    """Drive on sight at `ceiling_mps`; place and authority may be unknown."""
    protection_brakes: bool = False
    """The service brake comes from protection now, whatever is asked for."""
    kept_at_platform: bool = False
    """Something beside doors and authority stands against departure: the dwell goes on."""
    ahead_m: float = 0.0
    """The front may be so far ahead of `front_m`; protection looks from there."""
    slips: bool = False
    """Wheels slip or slide, or did a moment ago."""
    line_voltage_v: float | None = None
    """At the pantograph; None when the high-voltage box is silent or its breaker open."""


@dataclass(frozen=True, slots=True)
class AtoDemand:
    """What operation asks for; arbitration decides what goes out."""

    accel_mps2: float
    """Effort per mass asked of traction (positive) or service brake (negative).

    What gradient and resistance do to the train comes on top; operation reckons with both, so that
    one application of the brake stays one application.
    """
    hold: bool
    """Keep or bring the holding brake on."""
    open_doors: bool
    """Doors on the platform side of the present station shall be open."""
    phase: AtoPhase
    target_mps: float
    """Speed of the reference now."""
    distance_to_stop_m: float
    """To the next stopping point; math.inf when there is none."""
    reverse: bool = False
    """Positive `accel_mps2` drives backwards; only for a jog."""
    calls_for_help: bool = False
    """A person has to come: all attempts are used up and the train still does not stand right, or
    it does and its doors are not enabled for long, or it is to run and does not get away."""
    stopping_at_m: float | None = None
    """Stopping point that the train heads for or stands at; None while it heads for none."""
