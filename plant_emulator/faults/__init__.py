"""Faults: their catalogue, when each is active, and how scenario files describe them."""
