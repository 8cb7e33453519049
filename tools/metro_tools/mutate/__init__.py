"""Mutation testing: some test must detect every small mistake in the safety code."""
