"""Corrections of a session's odometry, ahead of the next version of a map."""
