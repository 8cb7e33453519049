"""Attacks on the protection by chance: braking curves against an oracle, and runs with faults."""
