"""Merges of maps."""
