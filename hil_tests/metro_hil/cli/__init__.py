"""The commands `vobc` and `hil`: parse, decide, do."""
