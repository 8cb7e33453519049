"""Sensors of the train, for its own motion and for the track."""
