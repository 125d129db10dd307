"""Retention: policies of maps, and the removal of what they do not keep."""
