"""Measures of a run or a case, computed from its logs."""
