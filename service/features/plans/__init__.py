"""Plans: pictures underneath a map, each held by two pins."""
