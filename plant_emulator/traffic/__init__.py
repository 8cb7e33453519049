"""Several trains on one line: timetable, dispatchers, authorities behind the leader, network."""
