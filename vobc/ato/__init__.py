"""Automatic train operation: from station to station within what protection permits."""

from vobc.ato.operation import Ato
from vobc.ato.settings.ato import AtoConfig

__all__ = ["Ato", "AtoConfig"]
