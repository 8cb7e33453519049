"""Exercises of a whole line of trains that command themselves: run, struck by faults and judged."""
