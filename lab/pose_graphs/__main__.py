"""`python -m lab.pose_graphs`: optimisation with wrong loops and broken odometry, and the cost of one loop more."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lab.command_line import named, run
from revisit.cli.output import progress_bar, refuse, reporter, say


def wrong_loops(
    folder: Annotated[Path, typer.Argument(exists=True, help="Folder of pose graphs, NAME.g2o.")],
    names: Annotated[str, typer.Option(help="Graphs by name, with commas; by default all of the table.")] = "",
    out: Annotated[Path, typer.Option(help="Folder for the table, its figures and the picture.")] = Path("out/graphs"),
    limit: Annotated[float, typer.Option(min=1.0, help="CPU seconds after which a method is stopped.")] = 60.0,
) -> None:
    """Put wrong loops into pose graphs: how far each method is from the optimum without them."""
    from lab.pose_graphs import benchmark

    chosen = named("--names", names, benchmark.GRAPHS)
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


def one_loop(
    poses: Annotated[int, typer.Option(min=200, help="Submaps of the made-up drive.")] = 10_000,
    count: Annotated[int, typer.Option(min=1, help="Loops that are taken in one by one.")] = 100,
    seed: Annotated[int, typer.Option(help="Seed of the drive.")] = 0,
) -> None:
    """Take loops into a large solved map one by one: CPU time of a correction."""
    from lab.pose_graphs import one_loop as benchmark

    found = benchmark.run(poses, count, seed)
    say(f"{found.poses} submaps, {found.loops} loops; factorised in {found.first_s:.2f} s")
    say(
        f"one loop more: median {found.median_ms:.0f} ms, p95 {found.p95_ms:.0f} ms CPU; {found.taken} of {count} taken"
    )
    say(f"{found.distance_m:.3f} m from a whole new optimisation (root mean square)")


def broken_odometry(seed: Annotated[int, typer.Option(help="Seed of the drives.")] = 1) -> None:
    """Two robots on one road, the odometry of one of which goes wrong: what the map makes of it, as a table."""
    from lab.pose_graphs import broken_odometry as benchmark

    say(benchmark.table(list(benchmark.run(seed=seed))))


def one_vote(
    folder: Annotated[Path, typer.Argument(exists=True, help="Folder of pose graphs, NAME.g2o.")],
) -> None:
    """Take whole stretches for others beside few right loops: whether what guards a map holds, as a table."""
    from lab.pose_graphs import one_vote as benchmark

    say(benchmark.table(list(benchmark.run(folder))))


if __name__ == "__main__":
    run(wrong_loops, one_loop, broken_odometry, one_vote)
