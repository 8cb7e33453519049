"""Network namespaces for controllers, and packet faults between them."""
