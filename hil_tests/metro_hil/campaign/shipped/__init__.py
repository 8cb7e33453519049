"""Campaigns that ship with the bench, one TOML file each."""
