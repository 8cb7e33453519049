"""`canlog diff`: what differs between two logs, or between two DBC files."""
