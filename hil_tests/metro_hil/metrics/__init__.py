"""Measures of a run or a case, computed from the logs that it left."""
