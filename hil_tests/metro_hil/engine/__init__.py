"""Runs campaigns: hands cases to workers, keeps a journal that survives kill -9, counts
verdicts."""
