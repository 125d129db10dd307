"""Online fitting of a learned field, one scan after the other (paper III-B 5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import ImplicitMapConfig
from revisit.core.implicit_map.decoder import DecoderWeights
from revisit.core.implicit_map.gradient_steps import learn_features
from revisit.core.implicit_map.neural_points import NeuralPoints, oriented
from revisit.core.implicit_map.settled import settled_rows
from revisit.core.implicit_map.visibility import by_scan
from revisit.core.kernels.gathered_returns import GatheredReturns
from revisit.core.kernels.voxel_table import rows_of, table_of, voxels_of
from revisit.core.submap import Submap

Array = NDArray[np.float32]


def learn_online(
    submap: Submap, points: NeuralPoints, most: int, decoder: DecoderWeights, config: ImplicitMapConfig,
    rng: np.random.Generator,
) -> tuple[Array, DecoderWeights]:  # fmt: skip
    """Features (n, F) of `points`, the settled ones of the whole `submap`, and the decoder after its last scan.

    Scan by scan: its returns join the neural points (at most `most`), which move and turn with them; samples are drawn
    along the rays of this scan alone; and the steps change the features of the neural points that are neighbours of a
    sample, and the decoder where it is updated. A point that the scans do not see again keeps its features.
    """
    grown = GatheredReturns(config.resolution, len(submap.points), most)
    features = np.zeros((0, decoder.feature_size), np.float32)
    standing, found = points, np.zeros(0, np.int64)
    clouds = by_scan(submap.points, submap.scan_index, len(submap.origins))
    for scan, (cloud, origin) in enumerate(zip(clouds, submap.origins, strict=True)):
        if not len(cloud):
            continue
        grown.insert(cloud, origin, scan)
        features = np.pad(features, ((0, len(grown.records) - len(features)), (0, 0)))
        standing, found = settled_rows(oriented(grown.records, config.resolution), config.resolution)
        origins = np.broadcast_to(origin, cloud.shape)
        features[found], decoder = learn_features(cloud, origins, standing, features[found], decoder, config, rng)
    table = table_of(voxels_of(standing.positions, config.resolution))
    rows = rows_of(table, voxels_of(points.positions, config.resolution))
    known = rows >= 0  # all but those that another point of their voxel stood for
    learned = np.zeros((len(points), decoder.feature_size), np.float32)
    learned[known] = features[found[rows[known]]]
    return learned, decoder
