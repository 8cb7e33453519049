"""Whoever sits at the driver's desk: nobody, a recording, a model of a driver, or a person."""
