"""All trains of a line with their controllers in virtual time: `vobc run --lockstep --trains`."""
