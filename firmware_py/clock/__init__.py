"""Time and rhythm: clocks, cyclic executive, watchdogs, and the real-time rights of the host."""
