"""Messages that need several frames: J1939 transport and ISO-TP, whole columns at a time."""
