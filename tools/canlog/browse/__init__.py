"""`canlog browse`: a log or a live bus on a terminal, for people with nothing but ssh."""
