"""Frames and their codes: rigid transforms, level frames, unit vectors as small integers, places on earth."""
