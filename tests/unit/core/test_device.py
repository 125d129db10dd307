"""Devices: torch answers as the compiled kernels do, candidates are joined, and a device that is missing is named."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import fields, replace
from functools import lru_cache, partial
from itertools import chain

import numpy as np
import pytest

from revisit.core.device import CPU, TORCH_ON_CPU, Device, MissingDevice, at_once, device, open_device, use, using
from revisit.core.device.contract import Alignment, AlignmentRules, Contact, ContactRules, Correlation, Kernels, Shifts
from revisit.core.geometry import se3
from revisit.core.kernels.patches import patches_of
from revisit.core.kernels.seen_columns import seen_columns
from revisit.core.place import Place
from revisit.core.verification import RejectedLoop, VerifiedLoop, verify
from revisit.core.verification.start import raster
from tests.support.yards import CONFIG, moved, recognised, thinned, yard

torch = pytest.importorskip("torch", reason="devices but the processor need torch")

FINE = AlignmentRules(edge=1.5, reach=1.0, rounds=6, facing_alike=0.5, robust=0.2, fewest=30)
COARSE = FINE._replace(reach=3.0, robust=0.6, rounds=10)
RULES = ContactRules(edge=1.0, reach=1.0, plane_distance=0.25, facing_alike=0.6, column_edge=2.0)
POSES = [se3.exp([0.4, -0.3, 0.1, 0.01, -0.02, 0.05]), se3.exp([0.0] * 6), se3.from_yaw(2.0, (9.0, 3.0, 0.0))]


@pytest.fixture(params=[CPU, TORCH_ON_CPU, *(["cuda"] if torch.cuda.is_available() else [])])
def kernels(request) -> Kernels:
    """The kernels of each device that is here."""
    return open_device(request.param).kernels


COMPILED = open_device(CPU).kernels


made_up_yard = lru_cache(maxsize=4)(yard)


@lru_cache(maxsize=16)
def cloud(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of a yard."""
    made_up = made_up_yard(seed)
    rows = np.random.default_rng(seed).permutation(len(made_up.vertices))[:count]
    return made_up.vertices[rows].astype(float), made_up.normals[rows].astype(float)


@lru_cache(maxsize=2)
def alignments(spread: float = 1.0) -> list[Alignment]:
    """Clouds of several sizes on the same and on other ones, one with too few points; all `spread` times as wide."""
    jobs = []
    for seed, count, pose in ((1, 900, POSES[0]), (1, 400, POSES[2]), (2, 700, POSES[0]), (1, 20, POSES[1])):
        points, normals = cloud(1, count)
        others, facing = cloud(seed, 3000)
        jobs.append(Alignment(pose, spread * points, normals, patches_of(spread * others, facing, FINE.edge)))
    return jobs


@lru_cache(maxsize=1)
def contacts() -> list[Contact]:
    """Surfaces of several sizes, partly where the other one has seen nothing."""
    jobs = []
    for seed, count, pose in ((1, 900, POSES[1]), (2, 500, POSES[0]), (1, 1, POSES[2])):
        points, normals = cloud(1, count)
        others, facing = cloud(seed, 3000)
        near = others[:, 0] < 10.0
        patches = patches_of(others[near], facing[near], RULES.edge)
        slots = seen_columns(np.ascontiguousarray(others[near]), RULES.column_edge).slots
        jobs.append(Contact(points, normals, count - count // 3, pose, patches, slots))
    return jobs


@pytest.mark.parametrize("rules", [FINE, COARSE])
def test_many_alignments_at_once_end_where_the_compiled_ones_do(kernels, rules):
    for found, expected in zip(kernels.align(alignments(), rules), COMPILED.align(alignments(), rules), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-9)


def test_an_alignment_moves_and_one_of_too_few_points_stays(kernels):
    first, *_, last = kernels.align(alignments(), COARSE)
    assert np.linalg.norm(first[:3, 3]) < 0.05 < np.linalg.norm(POSES[0][:3, 3])
    np.testing.assert_array_equal(last, POSES[1])


def test_points_too_far_apart_for_a_grid_are_aligned_as_well(kernels):
    jobs = alignments(spread=200.0)
    assert any(len(job.patches.grid) == 0 for job in jobs)
    for found, expected in zip(kernels.align(jobs, FINE), COMPILED.align(jobs, FINE), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-9)


def test_surfaces_touch_as_in_the_compiled_kernels(kernels):
    for found, expected in zip(kernels.touch(contacts(), RULES), COMPILED.touch(contacts(), RULES), strict=True):
        np.testing.assert_array_equal(found.counts, expected.counts)
        np.testing.assert_allclose(found.squares, expected.squares, atol=1e-9)
        np.testing.assert_allclose(found.information, expected.information, rtol=1e-9, atol=1e-6)
    assert expected.counts.max() <= 1 < COMPILED.touch(contacts(), RULES)[0].counts.min()


def test_shifted_surfaces_share_as_in_the_compiled_kernels(kernels):
    shifts = np.array([[0.0, 0.0, 0.0], [2.5, 0.0, 0.0], [0.0, -4.0, 0.1]])
    jobs = [
        Shifts(one.points, one.normals, shifts[: 1 + n], one.patches, one.slots) for n, one in enumerate(contacts())
    ]
    for found, expected in zip(kernels.share(jobs, RULES), COMPILED.share(jobs, RULES), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_plans_are_turned_and_shifted_as_in_the_compiled_kernels(kernels):
    plans = [np.ascontiguousarray(cloud(seed, 900)[0][:, :2]) for seed in (1, 2)]
    spectrum = np.fft.rfft2(raster(plans[0], 0.8).astype(np.float32)).astype(np.complex64)
    jobs = [Correlation(plans[0] + (4.0, -8.0), (0.0, 0.5), spectrum), Correlation(plans[1], (1.0,), spectrum)]
    jobs.append(Correlation(plans[1], (), spectrum))
    found, expected = kernels.correlate(jobs, 0.8), COMPILED.correlate(jobs, 0.8)
    for one, other in zip(chain(*found), chain(*expected), strict=True):
        assert one.peak == pytest.approx(other.peak, rel=1e-4)
        assert one.yaw == other.yaw
        np.testing.assert_array_equal(one.shift, other.shift)
    np.testing.assert_array_equal(found[0][0].shift, (-5.0, 10.0))
    assert [len(agreements) for agreements in found] == [4, 2, 0]


def test_no_jobs_have_no_answers(kernels):
    assert (kernels.align([], FINE), kernels.touch([], RULES), kernels.share([], RULES)) == ([], [], [])
    assert kernels.correlate([], 0.8) == []


@lru_cache(maxsize=1)
def candidates() -> tuple[Place, list[Place]]:
    """A revisit of a yard, and that yard among others."""
    T_match_query = se3.from_yaw(np.radians(75.0), (4.0, -3.0, 0.5))
    query = recognised(thinned(moved(made_up_yard(1), se3.inverse(T_match_query)), 0.7, seed=3))[1]
    return query, [recognised(made_up_yard(seed))[1] for seed in (1, 2, 3)]


def verifications() -> list[Callable[[], VerifiedLoop | RejectedLoop]]:
    """The verification of each candidate."""
    query, places = candidates()
    return [partial(verify, query, place, 0.9, CONFIG.verification) for place in places]


def test_candidates_verified_at_once_by_torch_have_the_verdicts_of_the_processor():
    with using(open_device(TORCH_ON_CPU)):
        found = at_once(verifications())
    assert [type(one) for one in found] == [VerifiedLoop, RejectedLoop, RejectedLoop]
    for one, other in zip(found, at_once(verifications()), strict=True):
        assert getattr(one, "reason", None) == getattr(other, "reason", None)
        for field in fields(one.measurement):
            if field.name != "rivals":
                values = getattr(one.measurement, field.name), getattr(other.measurement, field.name)
                np.testing.assert_allclose(*values, rtol=1e-6, atol=1e-6)


class Counting:
    """Compiled kernels that count what they are asked."""

    def __init__(self):
        self.calls: list[tuple[str, int]] = []

    def __getattr__(self, method):
        def call(jobs, rules):
            self.calls.append((method, len(jobs)))
            return getattr(COMPILED, method)(jobs, rules)

        return call


def test_calls_of_candidates_at_once_are_joined():
    alone, joined = Counting(), Counting()
    with using(Device("counting", alone)):
        expected = at_once(verifications())
    with using(Device("counting", joined, together=3)):
        found = at_once(verifications())
    assert [type(one) for one in found] == [type(one) for one in expected]
    assert sum(jobs for _, jobs in joined.calls) == sum(jobs for _, jobs in alone.calls)
    assert len(joined.calls) < len(alone.calls)
    assert ("correlate", 2) in joined.calls


def test_a_candidate_that_fails_leaves_the_others_alone_and_is_told():
    done = []

    def fails():
        raise KeyError("damaged")

    works = [verifications()[0], fails, lambda: done.append(verifications()[1]())]
    with using(replace(open_device(TORCH_ON_CPU), name="torch")), pytest.raises(KeyError, match="damaged"):
        at_once(works)
    assert isinstance(done[0], RejectedLoop)


def test_what_a_device_refuses_is_told_to_each_candidate_that_asked():
    class Broken:
        def __getattr__(self, method):
            raise RuntimeError("out of memory")

    with using(Device("broken", Broken(), together=3)), pytest.raises(RuntimeError, match="out of memory"):
        at_once(verifications())


@pytest.mark.parametrize("name", ["gpu", "cuda:99", "mps", "meta", ""])
def test_a_device_that_is_not_there_is_named(name):
    with pytest.raises(MissingDevice, match=f"device {name}"):
        open_device(name)


def test_without_torch_the_processor_works_and_other_devices_name_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    for module in [name for name in sys.modules if name.startswith("revisit.core.device.torch")]:
        monkeypatch.delitem(sys.modules, module)
    assert open_device(CPU).name == CPU
    with pytest.raises(MissingDevice, match=r"revisit-loops\[learned\]"):
        open_device(TORCH_ON_CPU)


def test_the_device_is_the_processor_until_another_is_chosen():
    assert device().name == CPU
    with using(open_device(TORCH_ON_CPU)):
        assert device().name == TORCH_ON_CPU
    assert device().name == CPU
    use(open_device(CPU))
    assert device().name == CPU
