"""`canlog browse`: shows a log or a live bus in a terminal, for instance over ssh."""
