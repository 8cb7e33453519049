"""Persistent storage: NVRAM, checked files, and the recorders of bus, ports and cycles."""
