"""Synthetic places for recognition tests: walls of random buildings around a yard, sampled as surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.bev import describe_bev
from revisit.core.clusters import segment_clusters
from revisit.core.config import PipelineConfig
from revisit.core.descriptor.fusion import PlaceDescriptor, PlaceFeatures, fuse
from revisit.core.geometry import se3
from revisit.core.micro.cluster_normals import describe_clusters
from revisit.core.micro.saliency import weigh_clusters
from revisit.core.model_bundle import load_packaged_models
from revisit.core.place import Place
from revisit.core.place.extraction import extract_place
from revisit.core.spectra import describe_spectra
from revisit.core.surface import Surface

RESOLUTION = 0.4
CONFIG = PipelineConfig()


def yard(seed: int, buildings: int = 14) -> Surface:
    """A surface with ground, the outer walls of random turned boxes, and their normals."""
    rng = np.random.default_rng(seed)
    walls = [_ground(rng)]
    for _ in range(buildings):
        centre, size = rng.uniform(-40, 40, 2), rng.uniform(3, 12, 2)
        walls.extend(_box(centre, size, rng.uniform(2.5, 8.0), rng.uniform(-np.pi, np.pi), rng))
    return surface_of(np.concatenate([wall[0] for wall in walls]), np.concatenate([wall[1] for wall in walls]))


def surface_of(points: NDArray[np.floating], normals: NDArray[np.floating]) -> Surface:
    """Points (n, 3) with normals (n, 3) as a surface; the voxels they fall in are occupied."""
    occupied = np.unique(np.floor(points / RESOLUTION).astype(np.int32), axis=0)
    return Surface(
        points.astype(np.float32), normals.astype(np.float32), np.zeros((0, 3), np.int32), occupied,
        np.ones(len(occupied), np.float32), RESOLUTION,
    )  # fmt: skip


def moved(surface: Surface, T_new_old: se3.Matrix4) -> Surface:
    """The same place seen from another frame."""
    return surface_of(se3.apply(T_new_old, surface.vertices), surface.normals @ T_new_old[:3, :3].T)


def thinned(surface: Surface, share: float, seed: int) -> Surface:
    """A random share of the vertices, and the voxels they fall in."""
    keep = np.random.default_rng(seed).random(len(surface.vertices)) < share
    return surface_of(surface.vertices[keep], surface.normals[keep])


def recognised(surface: Surface) -> tuple[PlaceDescriptor, Place]:
    """Descriptor and place of a surface, with the shipped codebooks."""
    models = load_packaged_models()
    clusters = segment_clusters(surface, CONFIG.clusters)
    bev = describe_bev(surface, clusters, CONFIG.bev)
    saliency = weigh_clusters(bev.keypoints, surface, clusters, CONFIG.micro.epsilon)
    micro = describe_clusters(surface, clusters, bev.keypoints, saliency, CONFIG.micro, np.random.default_rng(0))
    features = PlaceFeatures(bev, micro, describe_spectra(surface, clusters, CONFIG.spectra))
    descriptor = fuse(features, models.codebooks, CONFIG.fusion, models.version)
    return descriptor, extract_place(surface, clusters, bev, models.codebooks, CONFIG.verification)


def place_of_points(points: NDArray[np.floating], normals: NDArray[np.floating]) -> Place:
    """A place without keypoints whose points all stand."""
    nothing = np.zeros((0, 2), np.float32)
    _, template = recognised(yard(0))
    return replace(
        template, keypoints=nothing, orientations=nothing[:, 0], descriptors=np.zeros((0, len(template.parity))),
        points=points.astype(np.float32), normals=normals.astype(np.float32), standing_count=len(points),
    )  # fmt: skip


def _ground(rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    flat = rng.uniform(-45, 45, (12_000, 2))
    points = np.concatenate([flat, np.full((len(flat), 1), -1.5)], axis=1)
    return points, np.tile([0.0, 0.0, 1.0], (len(points), 1))


def _box(
    centre: NDArray[np.float64], size: NDArray[np.float64], height: float, yaw: float, rng: np.random.Generator
) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    walls = []
    for side in range(4):
        length, depth = (size if side % 2 else size[::-1]) / 2.0
        count = int(2 * length * height / 0.08)
        local = np.stack(
            [np.full(count, depth), rng.uniform(-length, length, count), rng.uniform(-1.5, height - 1.5, count)], axis=1
        )
        T = se3.from_yaw(yaw + side * np.pi / 2, (*centre, 0.0))
        walls.append((se3.apply(T, local), np.tile(T[:3, 0], (count, 1))))
    return walls
