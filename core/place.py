"""Place: what is kept of a submap for verification, in about eight kilobytes."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import VerificationConfig
from revisit.core.descriptor.vlad import Codebooks, project_locally
from revisit.core.geometry.level_frame import LevelFrame
from revisit.core.geometry.voxel_keys import first_rows, voxel_keys
from revisit.core.kept import Keeping
from revisit.core.place_form import PlaceContents, read_form, settled_form, write_form
from revisit.core.place_head import PlaceHead
from revisit.core.scan_disagreement import ScanDisagreement
from revisit.core.stages import stage

if TYPE_CHECKING:  # a place is read where nothing is described, without the libraries that this needs
    from revisit.core.bev import BevFeatures
    from revisit.core.clusters import Clusters
    from revisit.core.surface import Surface

Array = NDArray[np.float32]

CENTIMETRE = 0.01
CUBE_CORNER = 0.125
"""By how much of an edge the cubes begin before the origin that keep a surface point each: `place_surface.CORNER`."""


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

    def _contents(self) -> PlaceContents:
        return PlaceContents(**{field.name: getattr(self, field.name) for field in fields(PlaceContents)})


@stage("place")
def extract_place(
    surface: Surface,
    clusters: Clusters,
    bev: BevFeatures,
    codebooks: Codebooks,
    config: VerificationConfig,
) -> Place:
    """The place of a submap: its keypoints, and a thinned, evenly spread copy of its surface."""
    standing = _spread_rows(surface.vertices, ~clusters.ground, config.spacing, config.standing_points)
    ground = _spread_rows(surface.vertices, clusters.ground, 2.0 * config.spacing, config.ground_points)
    rows = np.concatenate([standing, ground])
    contents = PlaceContents(
        bev.keypoints, bev.orientations, project_locally(bev.descriptors, codebooks), codebooks.local_parity,
        surface.vertices[rows], surface.normals[rows], len(standing),
    )  # fmt: skip
    stored = settled_form(contents, float(config.spacing))
    return Place(**vars(stored), model=patch_model(codebooks), spacing=float(config.spacing))


def patch_model(codebooks: Codebooks) -> str:
    """A digest of the basis that keypoint descriptors are projected on: only those of one basis are comparable."""
    return hashlib.sha256(np.ascontiguousarray(codebooks.local_basis).tobytes()).hexdigest()[:16]


def _spread_rows(points: Array, chosen: NDArray[np.bool_], spacing: float, limit: int) -> NDArray[np.int64]:
    """One row for each cube of edge `spacing` among the chosen points; where still too many, those of least rank.

    Cubes of the least ranks are spread evenly, and of which rank one is need not be written (docs/decisions/0287).
    """
    from revisit.core.kernels.octree_coder import ranks_of  # the gateway reads keypoints without compiled code

    x, y, z = np.abs(points).T
    near = np.flatnonzero(chosen & (x < 300.0) & (y < 300.0) & (z < 300.0))
    cubes = np.floor(points[near].T.astype(np.float64) / spacing + CUBE_CORNER).astype(np.int64).T
    first = first_rows(voxel_keys(cubes))
    spread = near[first]
    if len(spread) <= limit:
        return np.asarray(spread)
    return np.asarray(spread[np.sort(np.argsort(ranks_of(cubes[first]), kind="stable")[:limit])])


def _centimetres(positions: Array) -> NDArray[np.int16]:
    return np.asarray(np.clip(np.rint(positions / CENTIMETRE), -32767, 32767), dtype="<i2")
