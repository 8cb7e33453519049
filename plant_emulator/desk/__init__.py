"""The operator of the driver's desk: none, a recording, a driver model or a person."""
