"""Attacks on the controller's inputs and data, and what must hold all the same."""
