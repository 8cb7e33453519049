"""The bench's base values: cases, verdicts, options, run folders, names of frames."""
