"""Monitors: invariants, formulas of temporal logic and limits of measures, watched during a run."""

from metro_hil.monitors.context import Context
from metro_hil.monitors.monitor_set import MonitorSet, Violation
from metro_hil.monitors.plan import MonitorKind, MonitorPlan, Severity, plans_of, read_monitors

__all__ = [
    "Context",
    "MonitorKind",
    "MonitorPlan",
    "MonitorSet",
    "Severity",
    "Violation",
    "plans_of",
    "read_monitors",
]
