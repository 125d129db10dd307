"""Maps, robots, sessions, submaps: create, get, list, delete, download."""
