"""A throw-away Linux guest with SocketCAN, for machines whose own kernel has none."""
