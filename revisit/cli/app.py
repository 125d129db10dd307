"""Commands and their options; the work is in the modules beside this one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from revisit.cli import access_commands, keeping

app = typer.Typer(
    name="revisit",
    help="Loop closure as a service for robot fleets.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

Http = Annotated[str, typer.Option(envvar="REVISIT_URL", help="URL of the service.")]
Grpc = Annotated[str, typer.Option(envvar="REVISIT_GRPC", help="host:port of the service's gRPC side.")]
Json = Annotated[bool, typer.Option("--json", help="Answer as JSON.")]
MapName = Annotated[str, typer.Option("--map", help="Id of the map.")]
Tau = Annotated[float | None, typer.Option(help="Metres per submap.")]
Stride = Annotated[float | None, typer.Option(help="Metres between submap starts.")]
IndexGap = Annotated[int | None, typer.Option(help="Nearer submaps are no loop.")]
PositiveRadius = Annotated[float | None, typer.Option(help="Submaps nearer than this are the same place, m.")]

RECORDINGS = "kitti, kitti360, mulran, nclt, clouds (pcd or ply with TUM or KITTI poses) or rosbag2 (mcap or db3)."

HTTP = "http://127.0.0.1:8080"
GRPC = "127.0.0.1:8090"


def run() -> None:
    """Run a command; what the service refuses is told in one line, with exit status 1."""
    from revisit.core.errors import RevisitError
    from revisit.sdk.errors import ApiError

    try:
        app()
    except (ApiError, RevisitError, OSError, TimeoutError) as error:
        unreachable = isinstance(error, ApiError) and error.reason == "UNREACHABLE"
        hint = " - is it running? `revisit serve` starts it" if unreachable else ""
        typer.echo(f"revisit: {error}{hint}", err=True)
        raise SystemExit(1) from error


@app.command()
def serve(
    home: Annotated[Path | None, typer.Option(help="Directory of the database and the blobs.")] = None,
    host: Annotated[str | None, typer.Option(help="Address to listen on.")] = None,
    http_port: Annotated[int | None, typer.Option(help="REST port; 0 takes a free one.")] = None,
    grpc_port: Annotated[int | None, typer.Option(help="gRPC port; 0 takes a free one.")] = None,
    workers: Annotated[int | None, typer.Option(help="Worker processes.")] = None,
) -> None:
    """Run the service: REST, gRPC and workers; its log is JSON. Options stand above the REVISIT_* variables."""
    from revisit.cli import running

    running.run_service("serve", home=home, host=host, http_port=http_port, grpc_port=grpc_port, workers=workers)


@app.command()
def worker(
    home: Annotated[Path | None, typer.Option(help="Directory of the database and the blobs.")] = None,
) -> None:
    """Run one more worker on this machine."""
    from revisit.cli import running

    running.run_service("worker", home=home)


@app.command()
def migrate(
    home: Annotated[Path | None, typer.Option(help="Directory of the database and the blobs.")] = None,
) -> None:
    """Bring the database to the schema of this version."""
    from revisit.cli import running

    running.run_service("migrate", home=home)


@app.command()
def ingest(
    folder: Annotated[Path, typer.Argument(exists=True, help="The recording.")],
    map_id: MapName = "default",
    session_id: Annotated[str, typer.Option("--session", help="Id of the session; the folder's name by default.")] = "",
    file_format: Annotated[str, typer.Option("--format", help=RECORDINGS)] = "kitti",
    scene_scale: Annotated[
        float | None, typer.Option(min=0.01, max=10.0, help="Size of a new map's scene compared with a street.")
    ] = None,
    grpc: Grpc = GRPC,
    limit: Annotated[int | None, typer.Option(min=1, help="Send at most so many scans.")] = None,
    spool: Annotated[
        Path | None, typer.Option(help="File that keeps scans on this machine until they are stored.")
    ] = None,
    wait: Annotated[bool, typer.Option(help="Wait until every submap is described.")] = True,
    finish: Annotated[bool, typer.Option(help="Finish the session after the last scan.")] = True,
    json: Json = False,
) -> None:
    """Stream a recording; run it again to resume."""
    from revisit.cli import ingesting
    from revisit.evaluation.datasets import open_recording

    recording = open_recording(folder, file_format)
    target = ingesting.Target(grpc, map_id, session_id or recording.name, scene_scale)
    extent = ingesting.Extent(limit, spool, finish, wait)
    try:
        ingesting.ingest(recording, target, extent, json)
    except KeyboardInterrupt as error:
        typer.echo("revisit: interrupted; the same command goes on where this one ended", err=True)
        raise typer.Exit(130) from error


@app.command()
def spool(
    file: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="The spool.")],
    send: Annotated[bool, typer.Option(help="Send what it holds first.")] = False,
    grpc: Grpc = GRPC,
    json: Json = False,
) -> None:
    """Show what a robot's spool holds and which scans the service refused; --send empties it first."""
    from revisit.cli import spooling

    spooling.show(file, grpc if send else None, json)


@app.command()
def query(
    cloud: Annotated[
        Path | None, typer.Argument(exists=True, dir_okay=False, help="A .bin, .pcd, .ply or .npy.")
    ] = None,
    map_id: MapName = "default",
    submap: Annotated[str, typer.Option(help="Search by SESSION/SUBMAP instead of localising a cloud.")] = "",
    k: Annotated[int, typer.Option(min=1, max=100, help="How many to compare or to show.")] = 10,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Say where a cloud was taken, or which submaps look like a submap."""
    from revisit.cli import asking

    asking.query(http, map_id, cloud, submap, k, json)


@app.command()
def loops(
    map_id: MapName = "default",
    state: Annotated[str, typer.Option(help="ACCEPTED, REJECTED or ALL.")] = "ACCEPTED",
    session_id: Annotated[str, typer.Option("--session", help="Only those found by this session.")] = "",
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """List the loop closures of a map."""
    from revisit.cli import asking

    asking.loops(http, map_id, state.upper(), session_id, json)


@app.command()
def export(
    map_id: MapName = "default",
    file_format: Annotated[str, typer.Option("--format", help="g2o, tum or csv.")] = "g2o",
    session_id: Annotated[str, typer.Option("--session", help="Only this session; tum needs one.")] = "",
    out: Annotated[Path | None, typer.Option(help="File to write; stdout by default.")] = None,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Write submap poses and accepted loops as a pose graph (g2o), a trajectory (tum) or a table of loops (csv)."""
    from revisit.cli import exporting

    exporting.export(http, exporting.Selection(map_id, session_id), file_format, out, json)


@app.command()
def demo(
    picture: Annotated[Path, typer.Option(help="PNG to write.")] = Path("out/demo.png"),
    seed: Annotated[int, typer.Option(help="Seed of the simulated town.")] = 1,
    json: Annotated[bool, typer.Option("--json", help="Print the exit status as JSON at the end.")] = False,
) -> None:
    """Start a service, drive two simulated robots through a town, compare the loops with the truth."""
    from revisit.cli.demo import run_demo
    from revisit.cli.output import emit_json

    status = run_demo(picture, seed=seed)
    if json:
        emit_json({"targets_reached": status == 0, "picture": str(picture)})
    raise typer.Exit(status)


@app.command()
def evaluate(
    folder: Annotated[Path, typer.Argument(exists=True, help="The recording.")],
    file_format: Annotated[str, typer.Option("--format", help=RECORDINGS)] = "kitti",
    json: Annotated[Path | None, typer.Option("--json", help="Write rows and summary to this file.")] = None,
    tau: Tau = None,
    stride: Stride = None,
    min_index_gap: IndexGap = None,
    positive_radius: PositiveRadius = None,
    rotate_seed: Annotated[int | None, typer.Option(help="Turn every submap by a random yaw of this seed.")] = None,
    keep_beams: Annotated[int | None, typer.Option(help="Keep so many of 64 beams.")] = None,
    keep_points: Annotated[float, typer.Option(help="Keep this share of the points.")] = 1.0,
    ablation: Annotated[str, typer.Option(help="none, no-implicit, bev-only or normals-only.")] = "none",
    scene_scale: Annotated[
        float | None, typer.Option(min=0.01, max=10.0, help="Size of the scene compared with a street; else estimated.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes.")] = None,
) -> None:
    """Score place recognition on a recording with poses, as the paper does."""
    from revisit.cli import evaluating

    options = evaluating.options(
        tau, stride, min_index_gap, positive_radius, rotate_seed, keep_beams, keep_points, ablation, scene_scale, jobs
    )
    evaluating.evaluate_folder(folder, file_format, options, json)


operations = typer.Typer(help="Look at the service's work, and queue again what has failed.", no_args_is_help=True)
app.add_typer(operations, name="operations")


@operations.command("list")
def operations_list(
    state: Annotated[str, typer.Option(help="QUEUED, RUNNING, DONE, FAILED or ALL.")] = "FAILED",
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """List operations with what they are about and why they failed; by default those that failed for good."""
    from revisit.cli import operating

    operating.list_operations(http, state.upper(), json)


@operations.command("retry")
def operations_retry(
    names: Annotated[list[str] | None, typer.Argument(help="Their ids.")] = None,
    every: Annotated[bool, typer.Option("--all", help="Every description that has failed.")] = False,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Queue failed descriptions again, with as many attempts as new ones."""
    from revisit.cli import operating

    operating.retry(http, names or [], every, json)


app.add_typer(access_commands.keys, name="keys")
app.add_typer(access_commands.audit, name="audit")


bench = typer.Typer(help="Measure the product.", invoke_without_command=True)
app.add_typer(bench, name="bench")


@bench.callback()
def bench_metrics(
    context: typer.Context,
    update: Annotated[bool, typer.Option(help="Write the measured figures as the new baseline.")] = False,
    json: Json = False,
) -> None:
    """Compare the declared metrics with the committed baseline; exit status 1 where one became worse."""
    if context.invoked_subcommand is None:
        from revisit.cli import benchmarking

        benchmarking.metrics(update, json)


@bench.command("run")
def bench_run(
    update: Annotated[bool, typer.Option(help="Write the measured figures as the new baseline.")] = False,
    json: Json = False,
) -> None:
    """The same as `revisit bench` alone."""
    from revisit.cli import benchmarking

    benchmarking.metrics(update, json)


@bench.command("recognition")
def bench_recognition(
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
) -> None:
    """Recognition of the product and of every baseline, as one report; a second run goes on where the first ended."""
    from revisit.cli import benchmarking

    own = benchmarking.OwnRecordings(tuple(recording or ()), sessions, file_format)
    lengths = benchmarking.Lengths(tau, stride, min_index_gap, positive_radius)
    benchmarking.recognition(out, recordings or out / "recordings", (drives, protocols), own, lengths, jobs)


@app.command()
def doctor(
    home: Annotated[Path | None, typer.Option(help="Directory of the database and the blobs.")] = None,
    http: Http = HTTP,
    grpc: Grpc = GRPC,
    full: Annotated[bool, typer.Option("--full", help="Read every blob instead of 200 of them.")] = False,
    json: Json = False,
) -> None:
    """Check versions, the models, the data folder and whether the service answers."""
    from revisit.cli import examining

    examining.doctor(home, http, grpc, json, full)


app.command()(keeping.backup)
app.command()(keeping.restore)
app.command()(keeping.scrub)
