"""Lines of several trains: in virtual time, as processes over zenoh, and their cost."""
