"""Divisions of the shipped lines for trains that command themselves, one TOML file for each."""
