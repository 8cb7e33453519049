"""What is kept: NVRAM, checked files, and the recorders of bus, ports and cycles."""
