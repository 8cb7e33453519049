"""Reference motion: speed profiles, braking curves, rate limits, running times."""
