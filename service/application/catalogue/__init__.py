"""The resources: maps, robots, sessions, submaps, loop closures; listing and deleting them."""
