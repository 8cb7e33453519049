"""Settings of the automatic operation and of each control law."""
