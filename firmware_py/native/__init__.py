"""Native code of the board: how C is built and kept, and the bus and the logs in C."""
