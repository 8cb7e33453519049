"""Runs the code blocks of README.md and docs as a reader would, and checks their output."""
