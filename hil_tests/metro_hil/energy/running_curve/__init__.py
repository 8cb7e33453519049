"""Power-limited running curves (seed 002): the net of all, the chosen one, and the optimum."""
