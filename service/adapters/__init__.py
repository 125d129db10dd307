"""Implementations of the ports: SQLite, files, vector indexes and the recogniser of `core`."""
