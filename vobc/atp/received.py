"""Received inputs that matter at stations. Missing inputs are read as the safe value."""

from dataclasses import dataclass

from vobc.atp.config import AtpConfig
from vobc.atp.inputs import DESK, DOORS
from vobc.vocabulary import CycleInput


@dataclass(frozen=True, slots=True)
class StationInputs:
    centre: bool
    """The orders are fresh. Otherwise every permission of the centre is false."""
    doors_left: bool
    doors_right: bool
    platform_doors_locked: bool
    awake: bool
    hold: bool
    stop_next: bool
    centre_emergency: bool
    doors_locked: bool
    door_bypass: bool
    passenger_alarm: bool
    """A fresh message of the desk reports an alarm. A silent desk stops the train anyway."""
    fire: bool
    """A fresh message reports a fire."""
    obstacle: bool
    """A fresh message reports that the obstacle deflector was touched."""
    no_obstacle: bool
    """A fresh message reports that the deflector was not touched."""


def listen(inputs: CycleInput, config: AtpConfig, gone: int) -> StationInputs:
    """Read the inputs. `gone` lists silent nodes as flags of `Missing`."""
    orders = inputs.orders if inputs.orders_age_s <= config.orders_age_max_s else None
    desk = None if gone & DESK else inputs.desk
    doors = None if gone & DOORS else inputs.doors
    alarms = inputs.alarms if inputs.alarms_age_s <= config.timeouts.alarms_s else None
    return StationInputs(
        centre=orders is not None,
        doors_left=orders is not None and orders.doors_left,
        doors_right=orders is not None and orders.doors_right,
        platform_doors_locked=orders is not None and orders.platform_doors_locked,
        awake=orders is not None and orders.awake,
        hold=orders is not None and orders.hold,
        stop_next=orders is not None and orders.stop_next,
        centre_emergency=orders is not None and orders.emergency,
        doors_locked=doors is not None and doors.closed_and_locked,
        door_bypass=desk is not None and desk.door_bypass_requested,
        passenger_alarm=desk is not None and not desk.no_passenger_alarm,
        fire=alarms is not None and not alarms.no_fire,
        obstacle=alarms is not None and not alarms.no_obstacle,
        no_obstacle=alarms is not None and alarms.no_obstacle,
    )
