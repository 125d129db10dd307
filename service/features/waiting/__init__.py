"""Waiting for a change of the store: one poll for all waiters."""
