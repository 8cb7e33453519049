"""One module for each format of a log: how it is read and how it is written."""
