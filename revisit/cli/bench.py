"""`revisit bench`: the declared metrics against the baseline, and the recognition report."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from revisit.cli.evaluate import given
from revisit.cli.extras import needs
from revisit.cli.options import RECORDINGS, IndexGap, Json, PositiveRadius, Stride, Tau
from revisit.cli.output import emit_json, emit_table, progress_bar, refuse, reporter, say
from revisit.service import ONE_THREAD

if TYPE_CHECKING:
    from revisit.evaluation.benchmark import Metric
    from revisit.evaluation.protocols.benchmark_plan import BenchmarkPlan

Update = Annotated[bool, typer.Option(help="Write the measured figures as the new baseline.")]
Check = Annotated[bool, typer.Option(help="End with status 1 where a figure is worse than the baseline by over 15 %.")]

OnDevice = Annotated[
    str | None,
    typer.Option(
        "--device",
        help="Measure this device beside the processor instead: cuda, cuda:N, or torch-cpu, which only compares.",
    ),
]

group = typer.Typer(help="Measure the product.", invoke_without_command=True)


@dataclass(frozen=True)
class OwnRecordings:
    """Recordings of the user's own: single ones, a pair (map, query), and their layout."""

    single: tuple[Path, ...]
    pair: tuple[Path, Path] | None
    file_format: str


@dataclass(frozen=True)
class Lengths:
    """How drives are cut and what counts as the same place: metres, the gap in submaps; None keeps the bench's own."""

    tau: float | None = None
    stride: float | None = None
    min_index_gap: int | None = None
    positive_radius_m: float | None = None

    def of(self, plan: BenchmarkPlan) -> BenchmarkPlan:
        """The plan with these lengths."""
        submap = given(tau=self.tau, stride=self.stride)
        loops = given(min_index_gap=self.min_index_gap, positive_radius_m=self.positive_radius_m)
        return replace(plan, submap=replace(plan.submap, **submap), loops=replace(plan.loops, **loops))


@group.callback()
@needs("evaluation")
def bench(
    context: typer.Context, check: Check = False, update: Update = False, json: Json = False, device: OnDevice = None
) -> None:
    """Measure the declared figures and name those that are worse than in the committed baseline."""
    os.environ.update(ONE_THREAD)  # before a library reads it: times are those of one thread
    if context.invoked_subcommand is None and device is not None:
        _measure_device(device, json)
    elif context.invoked_subcommand is None:
        _measure(check, update, json)


@group.command("run")
@needs("evaluation")
def run(check: Check = False, update: Update = False, json: Json = False) -> None:
    """The same as `revisit bench` alone."""
    _measure(check, update, json)


@group.command("recognition")
@needs("evaluation")
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
    min_index_gap: IndexGap = None,
    positive_radius: PositiveRadius = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    verified_peers: Annotated[
        bool, typer.Option("--verified-peers", help="Verify the first answers of every baseline, too.")
    ] = False,
    candidates: Annotated[int, typer.Option(min=1, help="How many first answers are verified.")] = 20,
) -> None:
    """Recognition of the product and of every baseline, as one report; a second run goes on where the first ended."""
    own = OwnRecordings(tuple(recording or ()), sessions, file_format)
    lengths = Lengths(tau, stride, min_index_gap, positive_radius)
    how = {"jobs": jobs, "verified_peers": verified_peers, "candidates": candidates}
    _compare_methods(out, recordings or out / "recordings", (drives, protocols), own, lengths, how)


@group.command("surface")
@needs("evaluation")
def surface(
    out: Annotated[Path, typer.Option(help="Folder for the tables, the picture and unpacked recordings.")] = Path(
        "out/surface"
    ),
    count: Annotated[int, typer.Option(min=1, help="Submaps of most groups of scenes.")] = 2,
) -> None:
    """How near stored neural maps come to the true surface, and how many bytes they take."""
    from revisit.evaluation.surfaces import bench as surfaces
    from revisit.evaluation.surfaces.scenes import scene_groups

    out.mkdir(parents=True, exist_ok=True)
    groups = scene_groups(out, count)
    rows = list(surfaces.compare_kinds(groups, say))
    (out / "kinds.md").write_text(surfaces.kinds_table(rows))
    street = next((name for name in groups if "real" in name), list(groups)[-1])
    curve = list(surfaces.compare_spacings(street, groups[street], say))
    (out / "spacings.md").write_text(surfaces.kinds_table(curve))
    surfaces.draw_curve(curve, out / "rate-distortion.png")
    say(f"{out / 'kinds.md'}, {out / 'spacings.md'} and {out / 'rate-distortion.png'}")


@group.command("bytes")
@needs("evaluation")
def stored(
    out: Annotated[Path, typer.Option(help="Folder for the table and unpacked recordings.")] = Path("out/bytes"),
) -> None:
    """What a kilometre takes in the store, by sensor: scans, neural maps, places and descriptors."""
    from revisit.evaluation.benchmark import storage

    out.mkdir(parents=True, exist_ok=True)
    rows = []
    for name, scans, config in storage.drives(out):
        say(name)
        rows.append(storage.stored_bytes(name, scans, config))
    (out / "bytes.md").write_text(storage.storage_table(rows))
    say(f"{out / 'bytes.md'}")


@group.command("store")
@needs("evaluation")
def store(
    out: Annotated[Path, typer.Option(help="Folder for the table, the services' data and unpacked recordings.")] = Path(
        "out/store"
    ),
) -> None:
    """What drives take on the disk, each streamed into a service of its own: blobs, database and all, as du has it."""
    from revisit.cli.stored_drives import stored_drives
    from revisit.evaluation.benchmark.store import store_table

    out.mkdir(parents=True, exist_ok=True)
    stores = []
    with progress_bar(quiet=False) as bar:
        for one in stored_drives(out, reporter(bar)):
            stores.append(one)
            (out / "store.md").write_text(store_table(stores))
    say(f"{out / 'store.md'}")


@group.command("graphs")
@needs("evaluation")
def graphs(
    folder: Annotated[Path, typer.Argument(exists=True, help="Folder of pose graphs, NAME.g2o.")],
    names: Annotated[str, typer.Option(help="Graphs by name, with commas; by default all of the table.")] = "",
    out: Annotated[Path, typer.Option(help="Folder for the table, its figures and the picture.")] = Path("out/graphs"),
    limit: Annotated[float, typer.Option(min=1.0, help="CPU seconds after which a method is stopped.")] = 60.0,
) -> None:
    """Put wrong loops into pose graphs: how far each method is from the optimum without them."""
    from revisit.evaluation import pose_graph_benchmark as benchmark

    chosen = _named("--names", names, benchmark.GRAPHS)
    missing = [name for name in chosen if not (folder / f"{name}.g2o").is_file()]
    if missing:
        raise refuse(f"{folder} lacks {', '.join(missing)} (.g2o)")
    total, outcomes = len(chosen) * len(benchmark.SPOILINGS) * len(benchmark.METHODS), []
    with progress_bar(quiet=False) as bar:
        report = reporter(bar)
        for _, outcome in benchmark.run(folder, chosen, limit):
            outcomes.append(outcome)
            benchmark.write(outcomes, out)
            report("methods on graphs", len(outcomes), total)
    benchmark.draw(folder, out, chosen)
    say(f"{len(outcomes)} runs in {out / 'pose-graphs.md'}")


@group.command("loops")
@needs("evaluation")
def loops(
    poses: Annotated[int, typer.Option(min=200, help="Submaps of the made-up drive.")] = 10_000,
    count: Annotated[int, typer.Option(min=1, help="Loops that are taken in one by one.")] = 100,
    seed: Annotated[int, typer.Option(help="Seed of the drive.")] = 0,
) -> None:
    """Take loops into a large solved map one by one: CPU time of a correction."""
    from revisit.evaluation import one_loop_benchmark as benchmark

    found = benchmark.run(poses, count, seed)
    say(f"{found.poses} submaps, {found.loops} loops; factorised in {found.first_s:.2f} s")
    say(
        f"one loop more: median {found.median_ms:.0f} ms, p95 {found.p95_ms:.0f} ms CPU; {found.taken} of {count} taken"
    )
    say(f"{found.distance_m:.3f} m from a whole new optimisation (root mean square)")


@group.command("fleet")
@needs("evaluation")
def fleet(
    out: Annotated[Path, typer.Option(help="Folder for the drives, the table, the pictures and TUM files.")] = Path(
        "out/fleet"
    ),
    seed: Annotated[int, typer.Option(help="Seed of the simulated town.")] = 1,
    only: Annotated[str, typer.Option(help="Kinds of wrong loops by name, with commas; all by default.")] = "",
) -> None:
    """Stream a simulated fleet into a service, put wrong loops into its map, compare the maps with the truth.

    The drives are streamed once: a second run goes on with what the first one has left in OUT.
    """
    from revisit.cli.fleet import SPOILINGS, run_fleet

    chosen = _named("--only", only, tuple(SPOILINGS))
    with progress_bar(quiet=False) as bar:
        outcomes = run_fleet(out, seed, reporter(bar), chosen)
    say((out / "fleet.md").read_text().rstrip("\n"))
    if not all(one.reached for one in outcomes):
        raise typer.Exit(1)


@group.command("domains")
@needs("evaluation")
def domains(
    out: Annotated[Path, typer.Option(help="Folder for the report, its pictures and the results.")] = Path(
        "out/domains"
    ),
    only: Annotated[str, typer.Option(help="Domains by name, with commas; all by default.")] = "",
    share: Annotated[
        float, typer.Option(min=0.1, max=1.0, help="How much of the winding ways is driven, 0.1 to 1.")
    ] = 1.0,
    candidates: Annotated[int, typer.Option(min=0, max=1000, help="First answers that are verified; 0: none.")] = 20,
) -> None:
    """Recognition in worlds built differently, with the worst of them; a second run goes on where the first ended.

    Domains of real data are left out unless REVISIT_DATA names their folder.
    """
    from revisit.evaluation.domains.catalogue import DOMAINS
    from revisit.evaluation.domains.evaluation import run_domains

    names = _named("--only", only, [domain.name for domain in DOMAINS])
    chosen = [domain for domain in DOMAINS if domain.name in names]
    with progress_bar(quiet=False) as bar:
        files = run_domains(chosen, out, reporter(bar), share=share, candidates=candidates)
    for domain in chosen:
        if domain.missing:
            say(f"{domain.name} was left out: {domain.missing}")
    say(f"{files[0]} and {files[1]}")


def _measure(check: bool, update: bool, as_json: bool) -> None:
    """Measure and show; with `check` exit with status 1 where a metric became worse than the baseline allows."""
    from revisit.evaluation import benchmark

    measured, regressions = benchmark.run(update=update)
    _show(measured, as_json, {"regressions": regressions})
    if not as_json:
        for regression in regressions:
            say(f"worse: {regression}")
    if check and regressions:
        raise typer.Exit(1)


def _measure_device(name: str, as_json: bool) -> None:
    """Measure a device beside the processor; exit with status 1 where what they find differs, or it is not there."""
    from revisit.core.device import MissingDevice
    from revisit.evaluation.benchmark.device import beside_the_processor

    try:
        measured = beside_the_processor(name)
    except MissingDevice as missing:
        raise refuse(f"--device: {missing}") from missing
    _show(measured, as_json, {})
    if any(metric.value for metric in measured if metric.key.endswith("_that_differ")):
        raise typer.Exit(1)


def _show(measured: Sequence[Metric], as_json: bool, more: dict[str, Any]) -> None:
    if as_json:
        emit_json({"metrics": [_finite(asdict(metric)) for metric in measured], **more})
    else:
        emit_table("Bench", ("metric", "value", "unit"), [(m.key, m.value, m.unit) for m in measured])


def _compare_methods(
    out: Path, recordings: Path, chosen: tuple[str, str], own: OwnRecordings, lengths: Lengths, how: dict[str, Any]
) -> None:
    """Run the recognition bench on the simulated drives, or on the user's own recordings, and name its report."""
    from revisit.evaluation import recognition_benchmark
    from revisit.evaluation.datasets import FORMATS
    from revisit.evaluation.protocols.benchmark_plan import PROTOCOLS, BenchmarkPlan

    if own.file_format not in FORMATS:
        raise refuse(f"--format is one of {', '.join(FORMATS)}")
    protocols = _named("--protocols", chosen[1], PROTOCOLS)
    plan = lengths.of(BenchmarkPlan(out, recordings, protocols=protocols, **how, **_sources(chosen[0], own)))
    with progress_bar(quiet=False) as bar:
        experiments, (markdown, page) = recognition_benchmark.run_recognition_bench(plan, reporter(bar))
    say(f"{len(experiments)} experiments in {markdown} and {page}")


def _sources(drives: str, own: OwnRecordings) -> dict[str, Any]:
    """What the plan runs on: own recordings where there are some."""
    from revisit.evaluation.protocols.benchmark_plan import RecordedDrive
    from revisit.evaluation.protocols.towns import DRIVES

    if own.single or own.pair:
        opened = [RecordedDrive(folder, own.file_format) for folder in own.single]
        pairs = [own.pair] if own.pair else []
        sessions = [tuple(RecordedDrive(folder, own.file_format) for folder in pair) for pair in pairs]
        return {"drives": opened, "sessions": sessions}
    names = _named("--drives", drives, [drive.name for drive in DRIVES])
    return {"drives": [drive for drive in DRIVES if drive.name in names]}


def _named(option: str, text: str, known: Sequence[str]) -> tuple[str, ...]:
    """The names in a list with commas; all that are known for an empty one."""
    names = tuple(name.strip() for name in text.split(",") if name.strip()) or tuple(known)
    unknown = [name for name in names if name not in known]
    if unknown:
        raise refuse(f"{option}: {', '.join(unknown)} is none of {', '.join(known)}")
    return names


def _finite(fields: dict[str, Any]) -> dict[str, Any]:
    """Infinite tolerances (figures that are shown only) as nothing: JSON has no infinity."""
    return {key: None if value == float("inf") else value for key, value in fields.items()}
