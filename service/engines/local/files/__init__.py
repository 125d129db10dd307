"""Blobs, index files, secrets and locks as files."""
