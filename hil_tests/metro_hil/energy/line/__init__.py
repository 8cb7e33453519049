"""A whole line by points of mass and its DC network: Green CBTC (seed 000) and what beats it."""
