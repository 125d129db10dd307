"""Versions of a map: pose graph optimisation, revert."""
