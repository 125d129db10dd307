"""Telling those who want to know: watching the events of a map, and webhooks."""
