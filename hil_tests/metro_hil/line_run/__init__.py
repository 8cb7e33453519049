"""All trains of a line with their controllers, each on its bus, in virtual time: `vobc run --trains`."""
