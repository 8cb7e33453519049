"""The on-board controller. It knows the world only through its wires."""
