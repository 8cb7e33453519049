"""Supervision of a line whose trains command themselves: what it shows, and what it decrees."""
