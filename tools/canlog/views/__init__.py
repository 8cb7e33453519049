"""Views of a log: signal traces, plots, and the page of `canlog report` and `canlog open`."""
