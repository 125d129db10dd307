"""Ports: the features' needs of the world outside, one protocol (or a few that belong together) a file."""
