"""Place: what is kept of a submap for verification (paper III-E).

extraction        the place of a submap
place             as it is kept, written and read, without compiled code where its surface is left out
correspondences   keypoints of two places that look alike
kept              what is computed of a place, once
"""

from revisit.core.place.place import Place

__all__ = ["Place"]
