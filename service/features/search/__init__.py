"""Queries by submap, descriptor and cloud; localisation."""
