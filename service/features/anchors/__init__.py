"""Anchors of sessions: post, list, delete, and where they put a map on earth."""
