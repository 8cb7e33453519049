"""A line that a user brings up by hand: its programs run until the user ends them."""
