"""The values at the bottom of the bench: cases, verdicts, options, run folders, names of frames."""
