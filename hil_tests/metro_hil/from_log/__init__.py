"""Makes a scenario from a recorded ride: reads the log, fits the train, writes the file, and
compares the simulated ride with the recorded one."""
