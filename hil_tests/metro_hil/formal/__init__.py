"""A TLA+ model of trains that command themselves; it is searched, and runs are checked."""
