"""A gateway between two bus segments that brings about the faults of the bus, on real CAN too."""
