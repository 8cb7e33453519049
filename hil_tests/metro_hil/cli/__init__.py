"""The commands `vobc` and `hil`: they parse, decide and act."""
