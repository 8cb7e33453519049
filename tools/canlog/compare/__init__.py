"""`canlog diff`: finds the differences between two logs or two DBC files."""
