"""Sweeping, forgetting, readiness, chores."""
