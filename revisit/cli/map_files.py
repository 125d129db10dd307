"""A map as one cloud, one mesh or one grid: submaps where its version in force, or an optimisation here, puts them."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revisit.cli.output import tell
from revisit.cli.pose_graph_files import Graph, pose_graph, read_graph
from revisit.cli.standing import SurfaceOf, Surfaces
from revisit.core.geometry.se3 import Matrix4
from revisit.core.point_columns import COLUMNS, Columns, PointColumn, at_rows, joined
from revisit.formats import pcd
from revisit.formats.cloud import DEFAULT_LIMITS
from revisit.sdk.client import Client

if TYPE_CHECKING:
    from revisit.core.implicit_map import NeuralMap
    from revisit.formats.mcap_map import DrivenPoses
    from revisit.sdk.resources import LoopClosure, Submap

Points = NDArray[np.float64]

CLOUD_VOXEL_M = 0.1
"""A merged cloud has one point in a voxel of this edge."""


@dataclass(frozen=True)
class PlacedSubmap:
    """A submap by its name, when it was taken, and where it lies in its `frame` of the map.

    Retention has removed the scans of one without `has_scans`, and the neural map of one that is `released`.
    """

    name: str
    stamp_ns: int
    T_map_submap: Matrix4
    frame: str = ""
    has_scans: bool = True
    released: bool = False

    @property
    def session(self) -> str:
        """The name of its session."""
        return self.name.partition("/submaps/")[0]


def placed_submaps(http: str, map_id: str, session_id: str = "") -> list[PlacedSubmap]:
    """The submaps of a map, or of one session, in the version that is in force; without one, optimised here.

    Where loops do not join all sessions, those of the largest group: other groups have frames of their own.
    """
    graph = read_graph(http, map_id, session_id)
    submaps = {one.name: one for track in graph.tracks for one in track}
    frames = _of_version(http, map_id, submaps, graph.loops) or _optimised_here(graph)
    frame = max(frames, key=lambda one: len(frames[one]), default="")
    return [_placed(submaps[name], pose, frame) for name, pose in frames.get(frame, {}).items()]


def _placed(submap: Submap, T_map_submap: Matrix4, frame: str) -> PlacedSubmap:
    has_scans, released = submap.kept_scans != "NONE", submap.state == "RETIRED" and submap.neural_map_bytes is None
    return PlacedSubmap(submap.name, submap.stamp_ns, T_map_submap, frame, has_scans, released)


def _of_version(
    http: str, map_id: str, submaps: Container[str], loops: Iterable[LoopClosure]
) -> dict[str, dict[str, Matrix4]]:
    """T_map_submap by submap, by frame, of the version in force; empty without one. Tells how many `loops` it lacks."""
    frames: dict[str, dict[str, Matrix4]] = {}
    with Client(http) as client:
        version = next((one for one in client.map_versions(f"maps/{map_id}") if one.in_force), None)
        for pose in client.submap_poses(version) if version else []:
            if pose.submap in submaps:
                frames.setdefault(pose.frame, {})[pose.submap] = pose.T_map_submap
    unknown = sum(loop.graph_state is None for loop in loops)
    if version is not None and unknown:
        tell(
            f"version {version.version} of map {map_id} was made before {unknown} of its loop closures: a worker makes "
            f"the next one soon, or at once with `revisit map optimise {map_id}`"
        )
    return frames


def _optimised_here(graph: Graph) -> dict[str, dict[str, Matrix4]]:
    """T_map_submap by submap, by group of sessions that loops join."""
    from revisit.core.pose_graph.optimisation import optimise

    posed = pose_graph(graph)
    if not posed.trajectories:
        return {}
    optimised = optimise(posed)
    names = {track[0].name.partition("/submaps/")[0]: [one.name for one in track] for track in graph.tracks if track}
    return {
        group[0]: {
            name: pose
            for session in group
            for name, pose in zip(names[session], optimised.T_map_submap[session], strict=True)
        }
        for group in optimised.components
    }


@dataclass(frozen=True)
class MergedCloud:
    """Points (n, 3) in the map, metres, and their columns; times are seconds since 1970 in the clocks of the robots.

    Where some submaps lack a column, it has the value that stands for an unknown one there (`PointColumn.missing`);
    without such a value it is `left_out`.
    """

    points: Points
    columns: Columns = field(default_factory=dict)
    left_out: tuple[str, ...] = ()

    def at(self, rows: NDArray[np.int64]) -> MergedCloud:
        """Some of its points."""
        return replace(self, points=self.points[rows], columns=at_rows(self.columns, rows))


def merged_cloud(
    http: str, placed: Sequence[PlacedSubmap], report: Callable[[str, int, int], None], *, ever: bool = False
) -> MergedCloud:
    """The points of all submaps in the map, one in a voxel; what a later drive looked through with `ever`.

    Those of the scans; of the surface where retention has removed these.
    """
    several = not ever and len({one.session for one in placed}) > 1
    needed = {row: number for number, row in enumerate(_needed(placed, several))}
    surfaces = _surfaces(http, [placed[row] for row in needed], report) if needed else None
    stands = surfaces.standing(report) if surfaces and several else [None] * len(needed)
    parts = list[MergedCloud]()
    with Client(http) as client:
        for row, one in enumerate(placed):
            number = needed.get(row)
            if surfaces and number is not None and not one.has_scans:
                cloud = MergedCloud(surfaces.points(number, stands[number]))
            else:
                read = pcd.decode(client.download(one.name, "pcd"), DEFAULT_LIMITS, COLUMNS)
                cloud = MergedCloud(read.points.astype(np.float64), read.columns)
                if surfaces and number is not None:
                    cloud = cloud.at(np.flatnonzero(~surfaces.gone(number, stands[number], cloud.points)))
            points = cloud.points @ one.T_map_submap[:3, :3].T + one.T_map_submap[:3, 3]
            parts.append(MergedCloud(points, cloud.columns).at(thinned(points)))
            report("clouds", row + 1, len(placed))
    whole = _joined(parts)
    return whole.at(thinned(whole.points))


def _needed(placed: Sequence[PlacedSubmap], several: bool) -> Iterator[int]:
    """The rows of those whose neural maps a cloud needs: all where drives are compared, else those without scans."""
    return (row for row, one in enumerate(placed) if several or not one.has_scans)


def _surfaces(http: str, placed: Sequence[PlacedSubmap], report: Callable[[str, int, int], None]) -> Surfaces:
    """The surfaces of the submaps; their sessions numbered in the order in which these are listed."""
    sessions = list(dict.fromkeys(one.session for one in placed))
    found = []
    with Client(http) as client:
        for number, one in enumerate(placed, 1):
            blob = client.download(one.name, "neural")
            found.append(SurfaceOf(blob, sessions.index(one.session), one.stamp_ns, one.T_map_submap))
            report("neural maps", number, len(placed))
    return Surfaces(found)


def _joined(parts: Sequence[MergedCloud]) -> MergedCloud:
    points = np.concatenate([np.zeros((0, 3)), *(part.points for part in parts)])
    told = {name for part in parts for name in part.columns}
    filled = {name: COLUMNS[name] for name in told if COLUMNS[name].missing is not None}
    whole = joined([_filled(part, filled.values()) for part in parts])
    return MergedCloud(points, whole, tuple(name for name in COLUMNS if name in told and name not in whole))


def _filled(part: MergedCloud, columns: Iterable[PointColumn]) -> Columns:
    """Its columns, and those that it lacks with the values that stand for unknown ones."""
    count = len(part.points)
    return {**{one.name: np.full(count, one.missing, one.kind) for one in columns}, **part.columns}


def thinned(points: Points) -> NDArray[np.int64]:
    """The first of the points (n, 3) in each voxel, in their order: their rows."""
    voxels = np.floor(points / CLOUD_VOXEL_M).astype(np.int64)
    voxels -= voxels.min(axis=0, initial=0)
    width, depth = (int(voxels[:, axis].max(initial=0)) + 1 for axis in (1, 2))
    keys = (voxels[:, 0] * width + voxels[:, 1]) * depth + voxels[:, 2]
    return np.sort(np.unique(keys, return_index=True)[1])


def merged_mesh(
    http: str, placed: Sequence[PlacedSubmap], report: Callable[[str, int, int], None], *, ever: bool = False
) -> tuple[Points, Points, NDArray[np.int32]]:
    """Vertices (v, 3) in metres in the map, their normals (v, 3) and faces (f, 3): the neural maps of all as one.

    What later drives looked through is there only with `ever`. They are merged about their middle, for neural maps hold
    single precision, which is half a metre in UTM.
    """
    from revisit.core.config import PipelineConfig
    from revisit.core.surface import extract_surface

    middle = np.rint(np.mean([one.T_map_submap[:3, 3] for one in placed], axis=0))
    surfaces = _surfaces(http, placed, report)
    stands = [None] * len(placed) if ever else surfaces.standing(report)
    neural_map = _merged_map(surfaces, stands, middle)
    surface = extract_surface(neural_map, PipelineConfig().surface)
    vertices = neural_map.frame.points_to_submap(surface.vertices).astype(np.float64)
    return vertices + middle, surface.normals @ neural_map.frame.rotation.T, surface.faces


def _merged_map(surfaces: Surfaces, stands: Sequence[NDArray[np.bool_] | None], middle: Points) -> NeuralMap:
    """One neural map out of what stands of those of all submaps, seen from `middle` (3,) in the map."""
    from revisit.core.geometry.se3 import from_yaw
    from revisit.core.merge.fused import merge_neural_maps

    maps, T_middle_map = [], from_yaw(0.0, -middle)
    for row, its in enumerate(stands):
        one = surfaces.placed(row)
        kept = one if its is None else one.only(its)
        maps.append(replace(kept, T_map_submap=T_middle_map @ one.T_map_submap))
    return merge_neural_maps(maps)


def as_kitti(placed: Sequence[PlacedSubmap]) -> tuple[str, str]:
    """Poses as KITTI lists them, 12 numbers a line, and the times of the lines in seconds."""
    ordered = sorted(placed, key=lambda one: (one.stamp_ns, one.name))
    poses = "".join(" ".join(f"{value:.9e}" for value in one.T_map_submap[:3].ravel()) + "\n" for one in ordered)
    return poses, "".join(f"{one.stamp_ns / 1e9:.9f}\n" for one in ordered)


def by_session(placed: Sequence[PlacedSubmap]) -> dict[str, DrivenPoses]:
    """The poses of each session, by its id, in the order of time."""
    from revisit.formats.mcap_map import DrivenPoses

    parts: dict[str, list[PlacedSubmap]] = {}
    for one in sorted(placed, key=lambda one: (one.stamp_ns, one.name)):
        parts.setdefault(one.name.split("/")[3], []).append(one)
    return {
        name: DrivenPoses(
            np.array([one.stamp_ns for one in part]), np.stack([np.asarray(one.T_map_submap) for one in part])
        )
        for name, part in sorted(parts.items())
    }


REFERENCE_POINTS = 12
"""Of a session: fleet adapters fit a similarity to four or more."""


def reference_points(http: str, placed: Sequence[PlacedSubmap]) -> dict[str, dict[str, list[list[float]]]]:
    """Pairs of points [x, y] at one spot, metres, by session: `rmf` in the map, `robot` in the session's odometry.

    So Open-RMF's fleet adapters have them under `reference_coordinates`; spread evenly over the drive of each session.
    """
    poses = {one.name: one.T_map_submap for one in placed}
    found: dict[str, dict[str, list[list[float]]]] = {}
    with Client(http) as client:
        for session in sorted({name.partition("/submaps/")[0] for name in poses}):
            submaps = [one for one in client.list_submaps(session) if one.name in poses]
            rows = np.unique(np.linspace(0, len(submaps) - 1, REFERENCE_POINTS).round().astype(int))
            chosen = [submaps[row] for row in rows]
            found[session.rpartition("/")[2]] = {
                "rmf": [poses[one.name][:2, 3].round(4).tolist() for one in chosen],
                "robot": [one.T_odom_submap[:2, 3].round(4).tolist() for one in chosen],
            }
    return found
