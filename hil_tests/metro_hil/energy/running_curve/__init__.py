"""Power-limited running curves [Ninh]: the net of all curves, the chosen one, and the optimum."""
