"""How the shipped lines are divided for trains that command themselves, one TOML file for each."""
