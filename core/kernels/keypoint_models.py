"""The layout of the models of coded keypoints, and neighbourhoods: of use without compiled code, too."""

from __future__ import annotations

WINDOW = 64
"""A keypoint is guessed from so many before it."""
FAR = 7
"""The class of the farthest, and of none."""
APART = (6, 14, 32, 64, 128, 256, 600)
"""Squared distances in cells, up to which a keypoint is of classes 0, 1 ... FAR - 1."""
ANGLE_BITS = 8
MOST_NUMBERS = 32
"""Numbers of a descriptor."""
HIGHEST = 65535
"""Cells reach from 0 to this along either axis."""
LONGEST_STEP = 15
TREE = 32
"""The first bits of an x, five, are guessed from those before."""

UP = 0
ASIDE = UP + LONGEST_STEP + 1
SAME = ASIDE + TREE + 16
OTHER = SAME + 2 * (FAR + 1)
ANGLE = OTHER + FAR + 1
SIZE = ANGLE + (1 << ANGLE_BITS)
SIGN = SIZE + MOST_NUMBERS * (FAR + 1) * 4
KEYPOINT_MODELS = SIGN + MOST_NUMBERS * (FAR + 1) * 16
