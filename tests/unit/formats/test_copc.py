"""COPC files that laspy reads, which shares nothing with the writer: all of it, a part, and coarsely."""

from __future__ import annotations

import subprocess
import sys

import laspy
import numpy as np
import pytest
from laspy.copc import Bounds, CopcReader

from revisit.core.errors import BadField
from revisit.formats import laz

copc = pytest.importorskip("revisit.formats.copc", reason="in the extra `crs`")

CORNER = (500_000.0, 5_400_000.0, 110.0)


@pytest.fixture
def points():
    return np.random.default_rng(0).uniform(0.0, 1.0, (40_000, 3)) * (120.0, 40.0, 5.0) + CORNER


def test_another_reader_finds_every_point_with_its_intensity(tmp_path, points):
    intensity = np.linspace(0.0, 1.0, len(points), dtype=np.float32)
    copc.write(tmp_path / "a.copc.laz", points, columns={"intensity": intensity})
    found = laspy.read(tmp_path / "a.copc.laz")
    order, expected = np.argsort(found.intensity, kind="stable"), np.argsort(intensity)
    np.testing.assert_allclose(np.sort(found.intensity / 65535), intensity[expected], atol=1e-5)
    np.testing.assert_allclose(found.xyz[order], points[expected], atol=0.00051)
    np.testing.assert_allclose(found.header.mins, points.min(axis=0), atol=0.00051)
    np.testing.assert_allclose(found.header.maxs, points.max(axis=0), atol=0.00051)
    assert (np.asarray(found.return_number) == 1).all() and (np.asarray(found.number_of_returns) == 1).all()


def test_a_viewer_loads_a_part_and_coarsely(tmp_path, points):
    copc.write(tmp_path / "a.copc.laz", points)
    low, high = np.array(CORNER[:2]) + (10.0, 5.0), np.array(CORNER[:2]) + (30.0, 25.0)
    inside = ((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1).sum()
    with CopcReader.open(tmp_path / "a.copc.laz") as reader:
        part = reader.query(bounds=Bounds(low, high))
        coarse = reader.query(level=0)
        side = 2 * reader.copc_info.halfsize
        np.testing.assert_allclose(reader.copc_info.center - side / 2, points.min(axis=0), atol=0.001)
    assert abs(len(part) - inside) <= 2  # at the edges, half a millimetre
    assert side == pytest.approx(np.ptp(points, axis=0).max(), abs=0.003)
    assert 1000 < len(coarse) < 0.6 * len(points)


def test_each_node_holds_each_of_its_points_once_and_one_in_a_cell():
    counts = np.random.default_rng(1).integers(0, 60_000, (30_000, 3)).astype(np.int32)
    nodes = list(copc.octree(counts))
    assert np.array_equal(np.sort(np.concatenate([rows for _, rows in nodes])), np.arange(len(counts)))
    names = [node for node, _ in nodes]
    assert len(set(names)) == len(names) and names[0] == (0, 0, 0, 0)
    side = float(np.ptp(counts.astype(np.int64), axis=0).max()) + 1
    for (depth, *place), rows in nodes:
        cube = side / 2**depth
        assert (((counts[rows] - counts.min(axis=0)) / cube).astype(int) == place).all()
        assert depth == 0 or (depth - 1, *(one // 2 for one in place)) in names
        cells = ((counts[rows] - counts.min(axis=0)) / (cube / copc.CELLS)).astype(int)
        assert len(rows) <= copc.FEW_POINTS or len(np.unique(cells, axis=0)) == len(rows)


def test_a_file_is_as_small_as_one_without_an_octree(tmp_path, points):
    copc.write(tmp_path / "a.copc.laz", points)
    in_order = points[np.lexsort(points.T[::-1])]
    assert (tmp_path / "a.copc.laz").stat().st_size < 1.1 * len(laz.encode(in_order))


@pytest.mark.parametrize("count", [1, 9_000])
def test_points_at_one_spot_are_written(tmp_path, count):
    copc.write(tmp_path / "a.copc.laz", np.full((count, 3), 7.0))
    np.testing.assert_allclose(laspy.read(tmp_path / "a.copc.laz").xyz, np.full((count, 3), 7.0), atol=1e-9)


def test_a_cloud_without_points_is_refused(tmp_path):
    with pytest.raises(BadField):
        copc.write(tmp_path / "a.copc.laz", np.zeros((0, 3)))


def test_a_file_for_which_there_is_no_room_leaves_nothing(tmp_path, points):
    """In a process of its own: the end of the writer's own object would take the process with it."""
    np.save(tmp_path / "points.npy", points)
    program = (
        "import pathlib, resource, sys, numpy as np; from revisit.formats import copc\n"
        "path = pathlib.Path(sys.argv[1])\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))\n"
        "try: copc.write(path / 'a.copc.laz', np.load(path / 'points.npy'))\n"
        "except OSError as error: print(error)\n"
    )
    ended = subprocess.run([sys.executable, "-c", program, tmp_path], capture_output=True, text=True, check=False)
    assert ended.returncode == 0 and "cannot be written" in ended.stdout
    assert [one.name for one in tmp_path.iterdir()] == ["points.npy"]


def test_a_folder_that_is_not_there_is_an_error_of_the_system(tmp_path, points):
    with pytest.raises(OSError, match="cannot be written"):
        copc.write(tmp_path / "no" / "a.copc.laz", points)
