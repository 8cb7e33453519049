"""Automatic train operation: from station to station within what protection permits."""

from vobc.ato.config import AtoConfig
from vobc.ato.operation import Ato

__all__ = ["Ato", "AtoConfig"]
