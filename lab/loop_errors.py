"""How far accepted loops are off, and whether their covariances say so.

`python -m lab.loop_errors OUT` prints the tables and draws the picture for a real street (where
REVISIT_DATA names its folder) and made-up towns and roads; truth is the recording's own pose, or exact.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # no display is needed

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from lab.command_line import run
from lab.domains.catalogue import DOMAINS, Domain, Setting
from lab.worlds.drives import DrivenWorld
from revisit.core.config import PipelineConfig, SubmapConfig, VerificationConfig
from revisit.core.geometry import se3
from revisit.core.pipeline import verify
from revisit.core.place import Place
from revisit.core.verification import VerifiedLoop
from revisit.evaluation.cutting import cut
from revisit.evaluation.datasets import Recording
from revisit.evaluation.described_submaps import DescribedSubmap, DescriptionWork, describe_submap
from revisit.evaluation.loop_closure_method import RevisitMethod
from revisit.evaluation.perturbations import Perturbation

Array64 = NDArray[np.float64]

WITHIN_M = 25.0
"""Pairs farther apart than this are not looked at."""

MOST_PAIRS = 400
"""Of more pairs of a recording, so many are looked at, evenly drawn."""

BOUND = float(chi2.ppf(0.95, 6))
"""A right covariance has 95 of 100 squared errors below this."""

OVERLAPS = (0.2, 0.3, 0.35, 0.4, 0.5, 0.6, 1.0)
DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")

ALL_SCANS = "frame of all scans"
_ROADS = ("country-road", "row-houses", "canyon", "woods", "thin-block", "kitti05-way", "facades", "resimulated")
_TOWNS = {"town": "town", "overgrown-town": "town"}  # and where the same drive has exact poses
_SHARE = 0.5
_APART_SCANS = 30


@dataclass(frozen=True)
class LoopError:
    """An accepted loop: its overlap, common points, and the error of its pose.

    error (6,): the tangent (x, y, z, rx, ry, rz), metres and radians in the match frame, that turns the estimate into
    the truth; covariance (6, 6) as stated for it; common: standing surface points of the smaller place.
    """

    overlap: float
    common: int
    error: Array64
    covariance: Array64

    @property
    def nees(self) -> float:
        """The squared error weighed by the stated covariance: 6 on average where that is right."""
        return float(self.error @ np.linalg.solve(self.covariance, self.error))


@dataclass(frozen=True)
class ErrorRow:
    """A bin of loops: NEES, metres and degrees of the errors (median and 95th percentile), and by direction.

    by_direction (6,): the root mean square of error over stated deviation; 1 is right.
    """

    loops: int
    median_nees: float
    share_inside: float
    metres: tuple[float, float]
    degrees: tuple[float, float]
    by_direction: Array64

    @classmethod
    def of(cls, errors: Sequence[LoopError]) -> ErrorRow:
        """The row of at least one loop."""
        nees, all_errors = np.array([one.nees for one in errors]), np.array([one.error for one in errors])
        stated = np.array([np.sqrt(np.diag(one.covariance)) for one in errors])
        metres = np.linalg.norm(all_errors[:, :3], axis=1)
        degrees = np.degrees(np.linalg.norm(all_errors[:, 3:], axis=1))
        return cls(
            len(errors), float(np.median(nees)), float((nees < BOUND).mean()),
            (float(np.median(metres)), float(np.quantile(metres, 0.95))),
            (float(np.median(degrees)), float(np.quantile(degrees, 0.95))),
            np.sqrt(((all_errors / stated) ** 2).mean(axis=0)),
        )  # fmt: skip


def loop_errors(
    pairs: Iterable[tuple[DescribedSubmap, DescribedSubmap]], config: VerificationConfig
) -> list[LoopError]:
    """The errors of those pairs (query, match) that verification accepts; `T_world_submap` is the truth."""
    found = []
    for query, match in pairs:
        if query.description is None or match.description is None:
            continue
        places = Place.from_blob(query.description.place), Place.from_blob(match.description.place)
        verdict = verify(*places, 1.0, config)
        if isinstance(verdict, VerifiedLoop):
            measured, T_true = verdict.measurement, true_pose(query, match)
            error = se3.log(T_true @ se3.inverse(measured.T_match_query))
            common = min(place.standing_count for place in places)
            found.append(LoopError(measured.overlap, common, error, measured.covariance))
    return found


def true_pose(query: DescribedSubmap, match: DescribedSubmap) -> se3.Matrix4:
    """T_match_query (4, 4) between the frames the submaps were described in, each turned by its yaw."""
    T = se3.inverse(match.T_world_submap) @ query.T_world_submap
    return np.asarray(se3.from_yaw(match.yaw) @ T @ se3.from_yaw(-query.yaw))


def near_pairs(
    queries: Sequence[DescribedSubmap], mapped: Sequence[DescribedSubmap], apart_scans: int = 0
) -> Iterable[tuple[DescribedSubmap, DescribedSubmap]]:
    """Pairs within WITHIN_M of each other, whose scans are at least `apart_scans` apart."""
    for query in queries:
        for match in mapped:
            near = np.linalg.norm(query.T_world_submap[:3, 3] - match.T_world_submap[:3, 3]) <= WITHIN_M
            if near and query.window[0] - match.window[0] >= apart_scans:
                yield query, match


def drawn_evenly(
    pairs: Iterable[tuple[DescribedSubmap, DescribedSubmap]], most: int = MOST_PAIRS
) -> list[tuple[DescribedSubmap, DescribedSubmap]]:
    """At most so many of the pairs of described submaps, evenly drawn from all."""
    described = [pair for pair in pairs if all(one.description is not None for one in pair)]
    if len(described) <= most:
        return described
    return [described[row] for row in np.linspace(0, len(described) - 1, most).astype(np.int64)]


def table(name: str, errors: Sequence[LoopError]) -> list[str]:
    """Lines of a Markdown table: all loops of a recording by bins of overlap, and together."""
    lines = []
    for low, high in (*pairwise(OVERLAPS), (OVERLAPS[0], OVERLAPS[-1])):
        inside = [one for one in errors if low <= one.overlap < high]
        if inside:
            row = ErrorRow.of(inside)
            by = ", ".join(f"{value:.2f}" for value in row.by_direction)
            lines.append(
                f"| {name} | {low:g} to {high:g} | {row.loops} | {row.median_nees:.2f} | {row.share_inside:.2f} | "
                f"{row.metres[0]:.2f}, {row.metres[1]:.2f} | {row.degrees[0]:.2f}, {row.degrees[1]:.2f} | {by} |"
            )
    return lines


def draw(errors: dict[str, Sequence[LoopError]], file: Path) -> None:
    """The share of loops below each NEES, for every recording, beside chi-square."""
    figure, axes = plt.subplots(figsize=(8, 5), layout="constrained")
    for name, some in errors.items():
        nees = np.sort([one.nees for one in some])
        axes.step(nees, np.arange(1, len(nees) + 1) / len(nees), where="post", label=f"{name} ({len(nees)})")
    values = np.geomspace(0.05, 300.0, 200)
    axes.plot(values, chi2.cdf(values, 6), color="black", linestyle="--", label="chi-square of 6")
    axes.axvline(BOUND, color="grey", linewidth=0.8)
    axes.set(xscale="log", xlim=(0.05, 300.0), ylim=(0.0, 1.01), xlabel="NEES", ylabel="share of accepted loops")
    axes.legend(loc="lower right")
    figure.savefig(file, dpi=90)
    plt.close(figure)


def describe_truly(recording: Recording, perturbation: Perturbation, config: SubmapConfig) -> list[DescribedSubmap]:
    """Submaps of a recording; a made-up recording's poses are replaced by the true ones."""
    work = DescriptionWork(recording, config, perturbation, RevisitMethod(PipelineConfig(submap=config)), 0)
    described = [describe_submap(work, task) for task in enumerate(cut(recording, config))]
    return in_true_frames(described, recording) if isinstance(recording, DrivenWorld) else described


def in_true_frames(submaps: Sequence[DescribedSubmap], drive: Recording) -> list[DescribedSubmap]:
    """The submaps with the exact pose of their middle scan on `drive`, a made-up one."""
    exact = drive.trajectory.T_world_sensor.__getitem__ if isinstance(drive, DrivenWorld) else drive.pose
    return [replace(one, T_world_submap=exact(one.window[len(one.window) // 2])) for one in submaps]


def as_all_scans_carry(submaps: Sequence[DescribedSubmap], world: DrivenWorld) -> list[DescribedSubmap]:
    """The submaps with the truth of their frame as all their scans carry it, on average, not the middle one alone.

    The recorded pose of the middle scan is the submap's frame: its own error is none of the surfaces of a loop.
    """
    truth, carried = world.trajectory.T_world_sensor, []
    for one in submaps:
        off = [se3.log(truth[index] @ se3.inverse(world.pose(index))) for index in one.window]
        T_recorded = world.pose(one.window[len(one.window) // 2])
        carried.append(replace(one, T_world_submap=se3.exp(np.mean(off, axis=0)) @ T_recorded))
    return carried


def _domain(name: str) -> Domain:
    return next(domain for domain in DOMAINS if domain.name == name)


def _of_drive(submaps: Sequence[DescribedSubmap]) -> list[LoopError]:
    pairs = drawn_evenly(near_pairs(submaps, submaps, _APART_SCANS))
    return loop_errors(pairs, PipelineConfig().verification)


def _of_town(name: str, setting: Setting) -> list[LoopError]:
    domain, exact = _domain(name), _domain(_TOWNS[name]).make(setting).queries
    submaps = describe_truly(domain.make(setting).queries, Perturbation(rotate_seed=1), domain.submap)
    return _of_drive(in_true_frames(submaps, exact))


def _of_road(name: str, setting: Setting, *, by_all_scans: bool = False) -> list[LoopError]:
    domain = _domain(name)
    recording = domain.make(setting).queries
    submaps = describe_truly(recording, Perturbation(rotate_seed=1), domain.submap)
    if by_all_scans and isinstance(recording, DrivenWorld):
        submaps = as_all_scans_carry(submaps, recording)
    return _of_drive(submaps)


def _of_all_scans(name: str, setting: Setting) -> list[LoopError]:
    return _of_road(name.removesuffix(f", {ALL_SCANS}"), setting, by_all_scans=True)


def _of_street(name: str, setting: Setting) -> list[LoopError]:
    domain = _domain(name)
    made = domain.make(setting)
    queries = describe_truly(made.queries, made.thinned_queries, domain.submap)
    mapped = describe_truly(made.mapped or made.queries, made.thinned_map, domain.submap)
    return loop_errors(drawn_evenly(near_pairs(queries, mapped)), PipelineConfig().verification)


def main(out: Path) -> None:
    """Print the tables and draw the picture."""
    out.mkdir(parents=True, exist_ok=True)
    street = [d.name for d in DOMAINS if d.name.startswith("real") and not d.missing]
    roads = [d.name for d in DOMAINS if d.name in _ROADS and not d.missing]
    makers: dict[str, Callable[[str, Setting], list[LoopError]]] = {
        **dict.fromkeys(street, _of_street),
        **dict.fromkeys(_TOWNS, _of_town),
        **dict.fromkeys(roads, _of_road),
        **{f"{name}, {ALL_SCANS}": _of_all_scans for name in roads},
    }
    print(f"| recording | overlap | loops | median NEES | within {BOUND:.1f} | m | degrees | {', '.join(DIRECTIONS)} |")
    print("|---|---|---|---|---|---|---|---|")
    errors: dict[str, Sequence[LoopError]] = {}
    for name, maker in makers.items():
        errors[name] = maker(name, Setting(out, _SHARE))
        print("\n".join(table(name, errors[name])), flush=True)
        draw(errors, out / "nees.png")


if __name__ == "__main__":
    run(main)
