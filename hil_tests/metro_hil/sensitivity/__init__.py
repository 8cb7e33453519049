"""Runs a campaign against mutated controllers and reports which scenario notices each mutant."""
