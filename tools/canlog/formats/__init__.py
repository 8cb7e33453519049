"""Readers and writers of log formats, one module each."""
