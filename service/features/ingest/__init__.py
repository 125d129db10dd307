"""Scans and submaps coming in."""
