"""Runs campaigns: cases to workers, results to a journal that survives kill -9, verdicts to totals."""
