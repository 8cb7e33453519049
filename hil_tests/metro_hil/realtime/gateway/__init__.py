"""A gateway between two bus segments that applies bus faults, on real CAN as well."""
