"""A place as it is kept and read: keypoints and surface of a submap, in about eight kilobytes."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from revisit.core.codec.place import PlaceContents, read_form, read_head, write_form
from revisit.core.codec.place_head import PlaceHead
from revisit.core.config import VerificationConfig
from revisit.core.geometry.level_frame import LevelFrame
from revisit.core.place.kept import Keeping
from revisit.core.scan_disagreement import ScanDisagreement

Array = NDArray[np.float32]

CENTIMETRE = 0.01


@dataclass(frozen=True)
class Place(Keeping):
    """Keypoints and surface of a submap as stored for verification, in the level frame.

    keypoints (n, 2) float32; orientations (n,) float32 radians in [0, pi); descriptors (n, l) float32 unit vectors;
    parity (l,) float32 +-1, their signs under a turn by 180 degrees; points (m, 3) float32 and normals (m, 3) float32
    unit, the first `standing_count` of them off the ground; model is the digest of the codebook of the descriptors;
    frame relates the level frame to that of the submap; `spacing` is the edge of the cubes of which the surface keeps a
    standing point each, and of twice the edge a ground point. `scan_disagreement` says how far the scans disagree on
    the surface (`core.scan_disagreement`), None where that is not known. Lengths are metres divided by the scene scale.
    All values but those of frame are the stored, quantised ones, so that parsing a blob gives the same place; frame
    survives within rounding.
    """

    keypoints: Array
    orientations: Array
    descriptors: Array
    parity: Array
    points: Array
    normals: Array
    standing_count: int
    model: str
    frame: LevelFrame = field(default_factory=LevelFrame)
    spacing: float = VerificationConfig().spacing
    scan_disagreement: ScanDisagreement | None = None

    @cached_property
    def content_digest(self) -> bytes:
        """A SHA-256 of where the surface and the keypoints lie, in centimetres of the level frame.

        It depends on nothing but the stored geometry: not on the session, the codebook or how the blob is compressed.
        """
        levels = _centimetres(self.points).tobytes() + _centimetres(self.keypoints).tobytes()
        return hashlib.sha256(levels).digest()

    def to_blob(self) -> bytes:
        """The place as bytes: magic, head, coded arrays, truncated SHA-256 over all of it.

        Of several surface points in one cube, or of more numbers of a descriptor than are kept, the first are written.
        """
        return write_form(self._contents(), PlaceHead(self.spacing, self.model, self.frame, self.scan_disagreement))

    @classmethod
    def from_blob(cls, blob: bytes, *, surface: bool = True) -> Place:
        """The inverse of `to_blob`. Raises FormerForm, DataLoss for anything else.

        Without `surface` its points are left out: then no compiled code is needed.
        """
        head, contents = read_form(blob, surface=surface)
        return cls(
            **vars(contents), model=head.model, frame=head.frame, spacing=head.spacing,
            scan_disagreement=head.scan_disagreement,
        )  # fmt: skip

    def as_stored(self, blob: bytes) -> Place:
        """What `from_blob` makes of `blob`, the stored form of this place, without reading it: its frame is rounded."""
        return replace(self, frame=read_head(blob).frame)

    def _contents(self) -> PlaceContents:
        return PlaceContents(**{field.name: getattr(self, field.name) for field in fields(PlaceContents)})


def _centimetres(positions: Array) -> NDArray[np.int16]:
    return np.asarray(np.clip(np.rint(positions / CENTIMETRE), -32767, 32767), dtype="<i2")
