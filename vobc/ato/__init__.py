"""Automatic train operation: drives from station to station within the limits of protection."""

from vobc.ato.operation import Ato
from vobc.ato.settings.ato import AtoConfig

__all__ = ["Ato", "AtoConfig"]
