"""Deletion in portions, and blobs that no row names."""
