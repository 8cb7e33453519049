"""Directed scenarios of train-to-train control: scripts that lead straight to one situation."""
