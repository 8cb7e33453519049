"""Supervision of a line of trains that command themselves: displays and operator commands."""
