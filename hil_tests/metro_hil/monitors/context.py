"""What monitors have to know of a run beside its frames and its truth."""

from dataclasses import dataclass

from firmware_py.trackdb import LineMap
from plant_emulator.train_config import TrainConfig


@dataclass(frozen=True, slots=True)
class Context:
    """Line, real train, and the values that were declared of both.

    A monitor of a train that was declared otherwise gets other values.
    """

    line: LineMap
    train: TrainConfig
    """What the train really is."""
    cycle_s: float = 0.05
    """Of the controller."""
    start_ns: int = 0
    guaranteed_decel_mps2: float = 1.0
    """The emergency brake gives no less on the level (GEBR), fully built up."""
    emergency_margin_mps: float = 8.0 / 3.6
    """Over the civil limit, from where on the emergency brake is to come."""
    runaway_mps2: float = 1.0
    """The worst that traction does against its command until it is cut."""
    sensing_s: float = 0.03
    traction_cut_s: float = 0.30
    """From the emergency brake being asked for to no tractive effort."""
    build_up_s: float = 1.05
    """From there to the emergency brake, for a train that coasts meanwhile."""
    rollback_m: float = 2.0
    jog_m: float = 5.0
    jog_mps: float = 5.0 / 3.6
    jog_attempts: int = 3
    restricted_mps: float = 25.0 / 3.6
    """On sight, with or without a driver."""
    flat_margin_mps: float = 5.0 / 3.6
    """Over these two speeds, from where on the emergency brake is to come."""
    cold_movement_m: float = 2.0
    """A train that was moved by no more while nobody controlled it still knows its place."""
    authority_age_s: float = 3.0
    """An authority that answers an older report is none any more (T_MA)."""
    takeover_s: float = 0.2
    """An emergency brake of the brake unit's own may be off for so long, until the controller has
    heard of it and asks for it, too."""
    brake_unit_s: float = 3.0
    """From the release of the emergency brake until its unit has to report it off."""
    reverse_s: float = 0.3
    """From the first effort backwards to the frame that says that the train jogs, or back."""
    reset_lifetime_s: float = 5.0
    """A reset that was pressed longer ago releases nothing any more."""
    zero_speed_mps: float = 3.0 / 3.6
    """Zero speed is declared under this only, and so are doors let open."""
    door_window_m: float = 0.30
    """To either side of the stopping point."""
    localisation_limit_m: float = 30.0
    """Width of the position interval over which the place is no longer known."""
    input_silence_s: float = 0.30
    """A moving train brakes when a vital input was not heard for longer."""
    service_accel_mps2: float = 0.85
    service_jerk_mps3: float = 0.65
    input_age_s: float = 0.0
    """By so much faults may delay what the controller hears. Its interval is wider by what the
    train may have moved since, and narrower again when something fresh comes."""
    lateness_s: float = 0.0
    """A cycle, or its frames, may be late by so much for which nobody is to blame."""
    settling_s: float = 0.0
    """So long after the start its claims are not judged: where train and controller do not begin
    with the same instant, the first inputs are older than those that follow."""
    slack_s: float = 0.02
    """For what happens between two samples and for frames that wait for the bus."""
