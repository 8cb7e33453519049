"""Pictures of a log: traces of signals, plots, the page of `canlog report` and `canlog open`."""
