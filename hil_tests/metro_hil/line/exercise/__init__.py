"""A whole line of trains that command themselves: run, struck by faults, watched, and told of."""
