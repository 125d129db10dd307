"""Events of a map."""
