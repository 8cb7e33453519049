"""Trains as running curves see them, one TOML file each; each says where its figures come from."""
