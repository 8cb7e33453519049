"""Imports foreign descriptions of lines and trains."""
