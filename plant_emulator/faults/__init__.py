"""Faults: what can be wrong (catalogue), when it is (window, schedule), and how it is written."""
