"""Pose graphs with wrong loops: how far each method is from the optimum without them."""

from __future__ import annotations

import json
import multiprocessing
import resource
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import Empty

import numpy as np
from numpy.typing import NDArray

from lab.pose_graphs.g2o_reading import read_g2o
from lab.pose_graphs.wrong_loops import is_wrong, with_agreeing_loops, with_random_loops
from revisit.core.pose_graph.graph import GraphState, PoseGraph
from revisit.core.pose_graph.optimisation import Robustness, optimise

GRAPHS = ("kitti_00", "kitti_05", "intel", "CSAIL", "sphere2500", "parking-garage")
METHODS = (Robustness.ONLINE, Robustness.COMMIT, Robustness.PLAIN, Robustness.HUBER, Robustness.GNC)
SEED = 4


@dataclass(frozen=True)
class Spoiling:
    """Which wrong loops are put in: their share of all loops, and whether they come in runs that agree."""

    share: float
    agreeing: bool = False

    @property
    def title(self) -> str:
        """As it stands in the table."""
        return "none" if not self.share else f"{100 * self.share:.0f} % {'agreeing' if self.agreeing else 'random'}"

    def of(self, graph: PoseGraph, seed: int) -> PoseGraph:
        """The graph with these wrong loops."""
        return (with_agreeing_loops if self.agreeing else with_random_loops)(graph, self.share, seed)


SPOILINGS = (Spoiling(0.0), Spoiling(0.1), Spoiling(0.3), Spoiling(0.5), Spoiling(0.8, agreeing=True))


@dataclass(frozen=True)
class Outcome:
    """One method on one graph: root mean square distance from the optimum without wrong loops, metres; loops kept and
    given, right and wrong; CPU seconds. `finished` is False where it was stopped at the time limit.
    """

    graph: str
    poses: int
    spoiling: str
    method: str
    finished: bool
    distance_m: float = float("nan")
    right_kept: int = 0
    right: int = 0
    wrong_kept: int = 0
    wrong: int = 0
    cpu_s: float = float("nan")


@dataclass(frozen=True)
class Case:
    """A graph file, the wrong loops put into it, and a method."""

    file: Path
    spoiling: Spoiling
    method: Robustness


def run(
    folder: Path, graphs: Sequence[str] = GRAPHS, limit_s: float = 120.0, seed: int = SEED
) -> Iterator[tuple[Case, Outcome]]:
    """Every method on every graph of `folder` with every kind of wrong loops, for `limit_s` CPU seconds at most."""
    for name in graphs:
        for spoiling in SPOILINGS:
            for method in METHODS:
                case = Case(folder / f"{name}.g2o", spoiling, method)
                yield case, within_limit(case, limit_s, seed)


def within_limit(case: Case, limit_s: float, seed: int = SEED) -> Outcome:
    """The outcome of a case, measured in a process of its own that may take `limit_s` CPU seconds."""
    context = multiprocessing.get_context("spawn")
    answers: multiprocessing.Queue[Outcome] = context.Queue()
    process = context.Process(target=_answer, args=(case, limit_s, seed, answers))
    process.start()
    while True:
        try:
            return answers.get(timeout=0.2)
        except Empty:
            if not process.is_alive():
                break
    process.join()
    graph = read_g2o(case.file.read_text())
    return Outcome(case.file.stem, _poses(graph), case.spoiling.title, case.method.value, finished=False)


def _answer(case: Case, limit_s: float, seed: int, answers: multiprocessing.Queue[Outcome]) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s), int(limit_s) + 1))
    answers.put(measure(case, seed))


def measure(case: Case, seed: int = SEED) -> Outcome:
    """Put the wrong loops in, optimise, compare with the plain optimum of the right loops alone."""
    graph = read_g2o(case.file.read_text())
    spoilt = case.spoiling.of(graph, seed)
    started = time.process_time()
    result = optimise(spoilt, case.method)
    cpu_s = time.process_time() - started
    best = optimise(graph, Robustness.PLAIN).T_map_submap
    kept = [loop for loop, state in zip(spoilt.loops, result.loops, strict=True) if state is GraphState.IN_MAP]
    wrong_kept = sum(map(is_wrong, kept))
    return Outcome(
        case.file.stem, _poses(graph), case.spoiling.title, case.method.value, True,
        rms_distance(result.T_map_submap, best), len(kept) - wrong_kept, len(graph.loops),
        wrong_kept, len(spoilt.loops) - len(graph.loops), cpu_s,
    )  # fmt: skip


def rms_distance(one: dict[str, NDArray[np.float64]], other: dict[str, NDArray[np.float64]]) -> float:
    """Root mean square distance between the positions of two solutions, metres; both hold the first pose fast."""
    gaps = np.concatenate([one[name][:, :3, 3] - other[name][:, :3, 3] for name in other])
    return float(np.sqrt(np.mean(np.sum(gaps**2, axis=1))))


def table(outcomes: Sequence[Outcome], methods: Sequence[Robustness] = METHODS) -> str:
    """The outcomes as a table in Markdown: a row a graph and kind of wrong loops, a column a method."""
    by_key = {(one.graph, one.spoiling, one.method): one for one in outcomes}
    rows = list(dict.fromkeys((one.graph, one.spoiling) for one in outcomes))
    lines = ["| graph | wrong loops | " + " | ".join(method.value for method in methods) + " |"]
    lines.append("|---|---|" + "---|" * len(methods))
    for graph, spoiling in rows:
        cells = [_cell(by_key.get((graph, spoiling, method.value))) for method in methods]
        lines.append(f"| {graph} | {spoiling} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _cell(outcome: Outcome | None) -> str:
    if outcome is None:
        return ""
    if not outcome.finished:
        return "stopped"
    kept = f"{100 * outcome.right_kept / max(outcome.right, 1):.1f} % / {outcome.wrong_kept}"
    return f"{outcome.distance_m:.2f} m, {kept}, {outcome.cpu_s:.1f} s"


def draw(folder: Path, out: Path, graphs: Sequence[str] = GRAPHS, seed: int = SEED) -> None:
    """A picture of each graph with half of its loops wrong: odometry, plain, and ours beside the optimum."""
    import matplotlib

    matplotlib.use("Agg")  # no display is needed
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, -(-len(graphs) // 2), figsize=(16, 10), layout="constrained")
    for name, axis in zip(graphs, axes.ravel(), strict=False):
        graph = read_g2o((folder / f"{name}.g2o").read_text())
        for (title, poses), (colour, style) in zip(_ways(graph, seed).items(), _STYLES, strict=True):
            axis.plot(poses[:, 0, 3], poses[:, 1, 3], style, color=colour, linewidth=1.0, label=title)
        axis.set(aspect="equal", title=f"{name}: {_poses(graph)} poses, {len(graph.loops)} loops", xlabel="x (m)")
    figure.legend(*axes.ravel()[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "pose-graphs.png", dpi=80)
    plt.close(figure)


def _ways(graph: PoseGraph, seed: int) -> dict[str, NDArray[np.float64]]:
    """Poses (n, 4, 4) of a graph of one session by method."""
    (one,), spoilt = graph.trajectories, Spoiling(0.5).of(graph, seed)
    return {
        "odometry": one.T_odom_submap,
        "optimum without wrong loops": optimise(graph, Robustness.PLAIN).T_map_submap[one.session],
        "online, half of the loops wrong": optimise(spoilt, Robustness.ONLINE).T_map_submap[one.session],
    }


_STYLES = (("tab:gray", ":"), ("tab:orange", "-"), ("tab:blue", "--"))


def write(outcomes: Sequence[Outcome], out: Path) -> None:
    """The outcomes as JSON and as a table, in folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "pose-graphs.json").write_text(json.dumps([asdict(one) for one in outcomes], indent=1) + "\n")
    (out / "pose-graphs.md").write_text(table(outcomes))


def _poses(graph: PoseGraph) -> int:
    return sum(map(len, graph.trajectories))
