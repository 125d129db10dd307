"""`python -m lab.recognition`: the product and every baseline on the same submaps and queries, as one report.

comparison           all methods on one set of queries
experiment           the results of one protocol on one sequence, as numbers in a file
directions           in which direction a place is passed again
benchmark_plan       which experiments make up the benchmark
sequential_baseline  MapClosures, which needs the submaps of a drive in their order
scan_baseline        BoW3D, which needs single scans and their lines
benchmark            all experiments of a plan
report, failures, pictures, document
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lab.command_line import named, run
from revisit.cli.evaluate import given
from revisit.cli.options import RECORDINGS, PositiveRadius, Stride, Tau
from revisit.cli.output import progress_bar, refuse, reporter, say

if TYPE_CHECKING:
    from lab.recognition.benchmark_plan import BenchmarkPlan


@dataclass(frozen=True)
class OwnRecordings:
    """Recordings of the user's own: single ones, a pair (map, query), and their layout."""

    single: tuple[Path, ...]
    pair: tuple[Path, Path] | None
    file_format: str


@dataclass(frozen=True)
class Lengths:
    """How drives are cut, and the radius of one place: metres, the gap in submaps; None keeps the bench's own."""

    tau: float | None = None
    stride: float | None = None
    min_index_gap: int | None = None
    positive_radius_m: float | None = None

    def of(self, plan: BenchmarkPlan) -> BenchmarkPlan:
        """The plan with these lengths."""
        submap = given(tau=self.tau, stride=self.stride)
        loops = given(min_index_gap=self.min_index_gap, positive_radius_m=self.positive_radius_m)
        return replace(plan, submap=replace(plan.submap, **submap), loops=replace(plan.loops, **loops))


def recognition(
    out: Annotated[Path, typer.Option(help="Folder for the report, its pictures and the outcomes.")] = Path(
        "out/recognition"
    ),
    recordings: Annotated[
        Path | None, typer.Option(help="Folder that keeps the simulated drives; OUT/recordings by default.")
    ] = None,
    drives: Annotated[str, typer.Option(help="Simulated drives by name, with commas; all by default.")] = "",
    protocols: Annotated[str, typer.Option(help="Protocols by name, with commas; all by default.")] = "",
    recording: Annotated[
        list[Path] | None, typer.Option(exists=True, help="A recording of your own instead; may be repeated.")
    ] = None,
    sessions: Annotated[
        tuple[Path, Path] | None, typer.Option(exists=True, help="MAP QUERY: two recordings in one world frame.")
    ] = None,
    file_format: Annotated[str, typer.Option("--format", help=RECORDINGS)] = "kitti",
    tau: Tau = None,
    stride: Stride = None,
    min_index_gap: Annotated[int | None, typer.Option(help="Nearer submaps are no loop.")] = None,
    positive_radius: PositiveRadius = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    verified_peers: Annotated[
        bool, typer.Option("--verified-peers", help="Verify the first answers of every baseline, too.")
    ] = False,
    peers: Annotated[bool, typer.Option(help="Compare with the baselines.")] = True,
    candidates: Annotated[int, typer.Option(min=1, help="How many first answers are verified.")] = 20,
) -> None:
    """Recognition of the product and of every baseline, as one report; a second run goes on where the first ended."""
    own = OwnRecordings(tuple(recording or ()), sessions, file_format)
    lengths = Lengths(tau, stride, min_index_gap, positive_radius)
    how: dict[str, Any] = {"jobs": jobs, "verified_peers": verified_peers, "candidates": candidates}
    if not peers:
        how["baselines"] = ()
    _compare_methods(out, recordings or out / "recordings", (drives, protocols), own, lengths, how)


def _compare_methods(
    out: Path, recordings: Path, chosen: tuple[str, str], own: OwnRecordings, lengths: Lengths, how: dict[str, Any]
) -> None:
    """Run the recognition bench on the simulated drives, or on the user's own recordings, and name its report."""
    from lab.recognition import benchmark
    from lab.recognition.benchmark_plan import PROTOCOLS, BenchmarkPlan
    from revisit.evaluation.datasets import FORMATS

    if own.file_format not in FORMATS:
        raise refuse(f"--format is one of {', '.join(FORMATS)}")
    protocols = named("--protocols", chosen[1], PROTOCOLS)
    plan = lengths.of(BenchmarkPlan(out, recordings, protocols=protocols, **how, **_sources(chosen[0], own)))
    with progress_bar(quiet=False) as bar:
        experiments, (markdown, page) = benchmark.run_recognition_bench(plan, reporter(bar))
    say(f"{len(experiments)} experiments in {markdown} and {page}")


def _sources(drives: str, own: OwnRecordings) -> dict[str, Any]:
    """The drives of the plan: own recordings where there are some."""
    from lab.recognition.benchmark_plan import RecordedDrive
    from lab.worlds.towns import DRIVES

    if own.single or own.pair:
        opened = [RecordedDrive(folder, own.file_format) for folder in own.single]
        pairs = [own.pair] if own.pair else []
        sessions = [tuple(RecordedDrive(folder, own.file_format) for folder in pair) for pair in pairs]
        return {"drives": opened, "sessions": sessions}
    names = named("--drives", drives, [drive.name for drive in DRIVES])
    return {"drives": [drive for drive in DRIVES if drive.name in names]}


if __name__ == "__main__":
    run(recognition)
