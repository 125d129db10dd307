"""Neural points and their features as a stream of bits, and back (docs/decisions/0287)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.codec.neural_chances import Mixtures, learned_mixtures
from revisit.core.errors import DataLoss
from revisit.core.geometry import octahedral
from revisit.core.kernels.feature_coder import code_features, feature_models
from revisit.core.kernels.guided_planes import code_guided_planes
from revisit.core.kernels.mixed_octree import code_mixed_octree
from revisit.core.kernels.plane_guesses import FIXED
from revisit.core.kernels.range_coder import Coder, finish, fresh_models, start
from revisit.core.kernels.voxel_table import distinct_rows, rows_of, table_of

Codes = NDArray[np.int32]

_BYTES_EACH = 16
_MAX_POINTS = 1 << 24
_MAX_DEPTH = 30
_MAX_FEATURES = 256
_COARSEST = 16
_NOTHING = np.zeros((0, 3), np.int32)


@dataclass(frozen=True)
class PlaneCodes:
    """Whole numbers of n neural points: voxels (n, 3) int32; planes (n, 4) int32, octahedral normal (2), offset of the
    tangent plane from the voxel's centre, and class of hits.
    """

    voxels: NDArray[np.int32]
    planes: NDArray[np.int32]

    def __getitem__(self, rows: NDArray[np.int64]) -> PlaneCodes:
        return PlaneCodes(self.voxels[rows], self.planes[rows])


@dataclass(frozen=True)
class Form:
    """What a reader must know before the bits: number of points and of features, the lowest voxel (3,), the depth of
    the octree above it, the steps in which normals and offsets are given, and by how many steps normals are written.
    """

    count: int
    features: int
    low: tuple[int, ...]
    depth: int
    normal_steps: int
    offset_unit: int
    normal_unit: int = 1

    def announced(self) -> list[int]:
        """What a header says of it."""
        steps = self.normal_steps, self.offset_unit, self.normal_unit
        return [self.count, self.features, *self.low, self.depth, *steps]

    @classmethod
    def of_header(cls, header: dict[str, Any]) -> Form:
        """The form that a header says. Raises KeyError, TypeError or ValueError for one that says none."""
        count, features, x, y, z, depth, steps, offset_unit, normal_unit = header["points"]
        return cls(count, features, (x, y, z), depth, steps, offset_unit, normal_unit)

    def checked(self) -> Form:
        """Itself. Raises DataLoss for numbers that no writer writes."""
        steps = (self.normal_steps, self.offset_unit, self.normal_unit)
        numbers = (self.count, self.features, *self.low, self.depth, *steps)
        bounds = (_MAX_POINTS, _MAX_FEATURES, *[1 << 30] * 3, _MAX_DEPTH, 127, FIXED, _COARSEST)
        least = (0, 0, *[-(1 << 30)] * 3, 0, 1, 1, 1)
        if len(numbers) != len(bounds) or not all(
            type(n) is int and a <= n <= b for n, a, b in zip(numbers, least, bounds, strict=True)
        ):
            raise DataLoss("the form of the neural map is unreadable")
        return self


def write_points(
    codes: PlaneCodes, features: Codes, normal_steps: int, offset_unit: int, normal_unit: int = 1,
    mixtures: Mixtures | None = None,
) -> tuple[Form, bytes]:  # fmt: skip
    """The stream of n points with `features` (n, F) int32, and its form.

    Their order is not kept; of several points in one voxel the first is written. With a `normal_unit` above 1 normals
    are rounded to so many steps from a neighbour's; what is read is written again as the same bytes. `mixtures` are for
    training: with others than the learned ones nothing can be read.
    """
    return written_points(codes, features, normal_steps, offset_unit, normal_unit, mixtures)[:2]


def written_points(
    codes: PlaneCodes, features: Codes, normal_steps: int, offset_unit: int, normal_unit: int = 1,
    mixtures: Mixtures | None = None,
) -> tuple[Form, bytes, PlaneCodes]:  # fmt: skip
    """As `write_points`, and the codes as they will be read."""
    rows = distinct_rows(codes.voxels)
    codes, features = codes[rows], features[rows]
    low = codes.voxels.min(axis=0, initial=1 << 30) if len(codes.voxels) else np.zeros(3, np.int32)
    voxels = np.asarray(codes.voxels - low, dtype=np.int32)
    depth = int(voxels.max(initial=0)).bit_length()
    low_voxel = tuple(int(v) for v in low)
    form = Form(
        len(voxels), features.shape[1], low_voxel, depth, normal_steps, offset_unit, normal_unit
    ).checked()  # fmt: skip
    room = 1024 + _BYTES_EACH * len(voxels) * (1 + features.shape[1] // 4)
    while True:
        data = np.zeros(room, dtype=np.uint8)
        used, read = _write(form, voxels, codes.planes, features, data, mixtures or learned_mixtures())
        if used <= room:
            return form, data[:used].tobytes(), read
        room = used


def _write(
    form: Form, voxels: Codes, planes: Codes, features: Codes, data: NDArray[np.uint8], mixtures: Mixtures
) -> tuple[int, PlaneCodes]:
    """Write into `data`: how many bytes that takes, and the codes as they will be read."""
    if form.count == 0:
        return 0, PlaneCodes(_NOTHING, planes)
    coder, low = start(data, False), np.array(form.low, dtype=np.int64)
    level = code_mixed_octree(coder, data, mixtures.octree, voxels, low, form.depth, form.count)
    rows, vectors = rows_of(table_of(voxels), level.voxels), _vectors(form.normal_steps)
    steps = form.normal_steps, form.normal_unit, form.offset_unit
    read = planes[rows]
    code_guided_planes(coder, data, mixtures.planes, level, low, read, vectors, *steps)
    _code_features(form, coder, data, features[rows])
    return finish(coder, data), PlaneCodes(_in_map(form, level.voxels), read)


def read_points(form: Form, stream: bytes) -> tuple[PlaneCodes, Codes]:
    """Codes and features of a stream. Raises DataLoss where it holds fewer points than announced."""
    form.checked()
    planes, features = np.zeros((form.count, 4), np.int32), np.zeros((form.count, form.features), np.int32)
    if form.count == 0:
        return PlaneCodes(_NOTHING, planes), features
    data = np.frombuffer(stream, np.uint8).copy()  # the compiled coder could also write
    coder = start(data, True)
    voxels = _read_planes(form, coder, data, planes)
    _code_features(form, coder, data, features)
    return PlaneCodes(_in_map(form, voxels), planes), features


def _in_map(form: Form, voxels: Codes) -> Codes:
    """Voxels (n, 3) above the lowest one of a form, as voxels of its map."""
    return voxels + np.asarray(form.low, dtype=np.int32)


def _read_planes(form: Form, coder: Coder, data: NDArray[np.uint8], planes: Codes) -> Codes:
    """Fill `planes` (n, 4); returns their voxels (n, 3)."""
    mixtures, low = learned_mixtures(), np.array(form.low, dtype=np.int64)
    level = code_mixed_octree(coder, data, mixtures.octree, _NOTHING, low, form.depth, form.count)
    _must_be_all(form, level.voxels)
    steps = form.normal_steps, form.normal_unit, form.offset_unit
    code_guided_planes(coder, data, mixtures.planes, level, low, planes, _vectors(form.normal_steps), *steps)
    return level.voxels


def _must_be_all(form: Form, voxels: Codes) -> None:
    if len(voxels) != form.count:
        raise DataLoss("the neural map does not hold as many points as it says")


def _code_features(form: Form, coder: Coder, data: NDArray[np.uint8], features: Codes) -> None:
    """Write `features` (n, F), or read and fill them."""
    if form.features:
        code_features(coder, data, fresh_models(feature_models(form.features)), features)


@lru_cache(maxsize=4)
def _vectors(steps: int) -> Codes:
    """The normal of each octahedral code, (2 * steps + 1, 2 * steps + 1, 3) in parts of FIXED."""
    side = np.arange(2 * steps + 1)
    codes = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    vectors = np.rint(octahedral.decode(codes, steps) * FIXED)
    return vectors.astype(np.int32).reshape(len(side), len(side), 3)
