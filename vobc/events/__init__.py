"""Events: decisions and observations of the controller, with their reasons and sources."""

from vobc.events.between import events_between
from vobc.events.start import controller_ends, memory_foreign, memory_lost

__all__ = ["controller_ends", "events_between", "memory_foreign", "memory_lost"]
