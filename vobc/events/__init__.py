"""What the controller decided and noticed, told as events: what, why, and from what it followed."""

from vobc.events.between import events_between
from vobc.events.start import controller_ends, memory_lost

__all__ = ["controller_ends", "events_between", "memory_lost"]
