"""`vobc device`, or `python -m vobc`: the bare controller in real time on a bus."""

from vobc.cli.command import main
from vobc.cli.host import (
    EXIT_ENVIRONMENT,
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_OK,
    EXIT_USAGE,
    PatientLine,
)
from vobc.cli.options import DevicePlan, parser, plan

__all__ = [
    "EXIT_ENVIRONMENT",
    "EXIT_FAILED",
    "EXIT_INTERRUPTED",
    "EXIT_OK",
    "EXIT_USAGE",
    "PatientLine",
    "DevicePlan",
    "main",
    "parser",
    "plan",
]
