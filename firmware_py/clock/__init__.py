"""Time and scheduling: clocks, cyclic executive, watchdogs, and real-time settings of the host."""
