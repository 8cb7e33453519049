"""Trains for running curves, one TOML file each, with the sources of their figures."""
