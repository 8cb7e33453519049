"""Energy: power-limited running curves of one train, and the DC network of a whole line."""
