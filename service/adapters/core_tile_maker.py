"""`core.merge.tiles` behind the port of tiles. Its libraries are loaded by the first tile."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revisit.core.codec.tile import FusedTile
from revisit.core.merge.evidence import DatedChange
from revisit.service.ports.map_merger import PlacedSubmapMap

if TYPE_CHECKING:
    from revisit.core.implicit_map import NeuralMap
    from revisit.core.merge.fused import PlacedMap

HELD_MAPS = 128
"""Neural maps that are kept decoded, 1 MB each: neighbouring tiles are made of the same."""


class CoreTileMaker:
    """`TileMaker` by `core.merge.tiles`."""

    def __init__(self) -> None:
        """Holds nothing yet."""
        self._held: OrderedDict[str, NeuralMap] = OrderedDict()

    def fuse(
        self, placed: Sequence[PlacedSubmapMap], centre_m: NDArray[np.float64], read: Callable[[str], bytes]
    ) -> FusedTile | None:
        """See `TileMaker`."""
        from revisit.core.merge.tiles import fuse_tile

        return fuse_tile(self._placed(placed, read), centre_m)

    def changes(
        self, placed: Sequence[PlacedSubmapMap], centre_m: NDArray[np.float64], read: Callable[[str], bytes]
    ) -> list[DatedChange]:
        """See `TileMaker`."""
        from revisit.core.merge.tiles import changes_in_tile

        return changes_in_tile(self._placed(placed, read), centre_m)

    def distances_m(
        self, neural_map: bytes, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """See `TileMaker`."""
        from revisit.core.merge.tiles import distances_m
        from revisit.service.adapters.core_neural_maps import decoded

        return distances_m(decoded(neural_map), points)

    def _placed(self, placed: Iterable[PlacedSubmapMap], read: Callable[[str], bytes]) -> Iterator[PlacedMap]:
        from revisit.core.merge.fused import PlacedMap

        for one in placed:
            yield PlacedMap(self._neural_map(one.sha256, read), one.T_map_submap, one.session, one.stamp_ns)

    def _neural_map(self, sha256: str, read: Callable[[str], bytes]) -> NeuralMap:
        """A neural map by its hash, independent of the tenant."""
        from revisit.service.adapters.core_neural_maps import decoded

        blob = read(sha256) if sha256 not in self._held else b""
        found = self._held.pop(sha256, None) or decoded(blob)
        self._held[sha256] = found
        while len(self._held) > HELD_MAPS:
            self._held.popitem(last=False)
        return found
