"""Alarms on board that a driver would notice: obstacle and fire."""

from dataclasses import dataclass

from can_dbc.binding import complete, frame


@frame("alarms.dbc", "TRAIN_ALARMS")
@dataclass(frozen=True, slots=True)
class TrainAlarms:
    no_obstacle: bool
    """The obstacle deflector in front of the first axle was not touched."""
    no_fire: bool
    """No smoke or fire detector of the train has tripped."""


complete("alarms.dbc")
