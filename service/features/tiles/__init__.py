"""Surfaces of a map in tiles."""
