"""The event log of a run: what its controller decided, why, and from which bytes on its wires."""
