"""Monitors: invariants, formulas of temporal logic and limits of measures, watched during a run."""

from metro_hil.monitors.context import Context
from metro_hil.monitors.monitor_set import NOT_EXERCISED, MonitorSet, Violation
from metro_hil.monitors.plan import MonitorKind, MonitorPlan, Severity, read_monitors

__all__ = [
    "NOT_EXERCISED",
    "Context",
    "MonitorKind",
    "MonitorPlan",
    "MonitorSet",
    "Severity",
    "Violation",
    "read_monitors",
]
