"""Mutation testing: every small mistake in the safety half must be noticed by some test."""
