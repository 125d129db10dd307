"""Retention, sweeping, readiness, chores."""
