"""Attacks on the controller's inputs and data, and the rules that must hold nevertheless."""
