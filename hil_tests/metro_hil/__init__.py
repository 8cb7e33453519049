"""The bench: runs controller and plant together, measures what came out and reports it."""
