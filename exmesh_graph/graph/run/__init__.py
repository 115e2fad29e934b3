"""Planning and running a checked graph."""
