"""What monitors need to know about a run besides its frames and its truth."""

from dataclasses import dataclass

from firmware_py.trackdb import LineMap
from plant_emulator.train_config import TrainConfig


@dataclass(frozen=True, slots=True)
class Context:
    """The line, the real train and the values declared for both.

    A train with other declared values gets a context with these values.
    """

    line: LineMap
    train: TrainConfig
    """The real train, which may differ from the train that the controller believes."""
    cycle_s: float = 0.05
    """Cycle of the controller."""
    start_ns: int = 0
    guaranteed_decel_mps2: float = 1.0
    """Guaranteed emergency brake rate (GEBR) on level track, fully built up."""
    emergency_margin_mps: float = 8.0 / 3.6
    """Excess over the civil limit at which the emergency brake must be applied."""
    runaway_mps2: float = 1.0
    """Greatest acceleration of traction against its command, until traction is cut."""
    sensing_s: float = 0.03
    traction_cut_s: float = 0.30
    """Time from the demand for the emergency brake until there is no tractive effort."""
    build_up_s: float = 1.05
    """Time from the traction cut to the full emergency brake; the train coasts meanwhile."""
    jog_m: float = 5.0
    jog_mps: float = 5.0 / 3.6
    jog_attempts: int = 3
    restricted_mps: float = 25.0 / 3.6
    """Permitted speed on sight, with or without a driver."""
    flat_margin_mps: float = 5.0 / 3.6
    """Excess over the speeds for jog and on sight at which the emergency brake must be applied."""
    cold_movement_m: float = 2.0
    """Greatest movement while the controller was off after which the position is still valid."""
    authority_age_s: float = 3.0
    """Maximum age of the position report that an authority answers (T_MA)."""
    takeover_s: float = 0.2
    """Time for which an emergency brake applied by the brake unit may be off. Until then the
    controller must have received that report and demand the brake, too."""
    brake_unit_s: float = 3.0
    """Time from the release of the emergency brake until the brake unit has to report it off."""
    reverse_s: float = 0.3
    """Longest time between the first effort backwards and the VOBC_MODE frame that reports a jog,
    in either order."""
    reset_lifetime_s: float = 5.0
    """Time after a press of the reset within which it releases the emergency brake."""
    zero_speed_mps: float = 3.0 / 3.6
    """Speed below which zero speed may be declared and doors may be enabled."""
    door_window_m: float = 0.30
    """Distance to either side of the stopping point within which doors may be open."""
    localisation_limit_m: float = 30.0
    """Width of the position interval beyond which the train is no longer localised."""
    input_silence_s: float = 0.30
    """Age of a vital input beyond which a moving train brakes."""
    service_accel_mps2: float = 0.85
    service_jerk_mps3: float = 0.65
    input_age_s: float = 0.0
    """Time by which faults may delay the controller's inputs. Its position interval is wider by the
    possible movement in that time, and narrower again after a fresh input."""
    lateness_s: float = 0.0
    """Lateness of a cycle or its frames that no one is responsible for."""
    settling_s: float = 0.0
    """Time after the start in which claims are not judged. Where train and controller do not start
    at the same instant, the first inputs are older than later ones."""
    slack_s: float = 0.02
    """Allowance for events between two samples and for frames that wait for the bus."""
