"""The map of the simulated fleet, made by a service with more and more wrong loops, against the truth."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from lab.fleet.figure import FleetFigure, draw
from lab.fleet.recording import MAP, SETTINGS, Report, recorded
from lab.fleet.scores import FleetOutcome, aligned, ate_m, poses_without_wrong_loops, table
from lab.fleet.spoiling import put_in
from lab.fleet.wrong_loops import PlacedSubmap, agreeing_loops, random_loops
from revisit.cli.demo.own_service import running_service
from revisit.cli.pose_graph_files import Graph, pose_graph, read_graph, tum_lines
from revisit.core.geometry.se3 import Matrix4
from revisit.evaluation.demo.truth import FoundLoop, Targets, TrueSubmap, compare
from revisit.sdk.client import Client

SPOILINGS: Mapping[str, tuple[float, Callable[[Sequence[PlacedSubmap], int, int], list[FoundLoop]]]] = {
    "none": (0.0, random_loops),
    "10 % random": (0.1, random_loops),
    "30 % random": (0.3, random_loops),
    "50 % random": (0.5, random_loops),
    "80 % that agree": (0.8, agreeing_loops),
}
"""Wrong loops by their name in the table: their share of all loops, and how they are made."""

_OPTIMISED_WITHIN_S = 1800.0


@dataclass(frozen=True)
class MapOfFleet:
    """The service's answers: T_map_submap by name in the largest frame, the names of loops in the map, the graph
    that it rests on, and how long the optimisation took.
    """

    poses: Mapping[str, Matrix4]
    in_map: frozenset[str]
    graph: Graph
    seconds: float


def run_fleet(out: Path, seed: int, report: Report, chosen: Sequence[str] = ()) -> list[FleetOutcome]:
    """Stream the drives once, put each kind of wrong loops into a copy, optimise it, measure it.

    Writes fleet.md, fleet.json, a picture, and the trajectories with the truth as TUM files into `out`.
    """
    submaps = recorded(out, seed, report)
    outcomes = []
    for title in chosen or SPOILINGS:
        made = _made(out, title, submaps, seed)
        judged = _judged(submaps, made)
        outcomes.append(_outcome(title, submaps, made, judged))
        _write(out, outcomes, submaps, made, judged)
        report("maps of the fleet", len(outcomes), len(chosen or SPOILINGS))
    return outcomes


def _made(out: Path, title: str, submaps: Sequence[PlacedSubmap], seed: int) -> MapOfFleet:
    """The map that a service makes of a copy of the recording with wrong loops in it."""
    share, wrong_loops = SPOILINGS[title]
    home = out / "spoilt"
    shutil.rmtree(home, ignore_errors=True)
    shutil.copytree(out / "service", home)
    if share:
        with running_service(home, SETTINGS) as addresses, Client(addresses.http) as client:
            found = len(client.loop_closures(f"maps/{MAP}", state="ACCEPTED"))
        put_in(home / "data", MAP, wrong_loops(submaps, round(found * share / (1.0 - share)), seed), seed)
    with running_service(home, SETTINGS) as addresses, Client(addresses.http) as client:
        return _optimised(client, addresses.http)


def _optimised(client: Client, http: str) -> MapOfFleet:
    started = time.monotonic()
    done = client.wait(client.optimise_map(f"maps/{MAP}"), _OPTIMISED_WITHIN_S)
    seconds = time.monotonic() - started
    frames: dict[str, dict[str, Matrix4]] = {}
    for pose in client.submap_poses((done.result or {})["version"]):
        frames.setdefault(pose.frame, {})[pose.submap] = pose.T_map_submap
    in_map = frozenset(loop.name for loop in client.loop_closures(f"maps/{MAP}", graph_state="IN_MAP"))
    return MapOfFleet(max(frames.values(), key=len), in_map, read_graph(http, MAP), seconds)


def _judged(submaps: Sequence[PlacedSubmap], made: MapOfFleet) -> dict[str, bool]:
    """Whether each accepted loop, by name, is wrong: off by more than 2 m or 5 degrees."""
    truth = {
        one.name: TrueSubmap(one.name, one.session, order, one.T_world_submap[:3, 3], one.T_world_submap)
        for order, one in enumerate(submaps)
    }
    loops = [loop for loop in made.graph.loops if loop.T_match_query is not None]
    found = [FoundLoop(loop.query, loop.match, loop.T_match_query) for loop in loops if loop.T_match_query is not None]
    judged = compare(truth, found, Targets()).loops
    return {loop.name: verdict.false for loop, verdict in zip(loops, judged, strict=True)}


def _outcome(title: str, submaps: Sequence[PlacedSubmap], made: MapOfFleet, judged: Mapping[str, bool]) -> FleetOutcome:
    truth = {one.name: one.T_world_submap for one in submaps}
    wrong = {name for name, false in judged.items() if false}
    clean = poses_without_wrong_loops(pose_graph(made.graph), wrong)
    names = {track[0].name.partition("/submaps/")[0]: [one.name for one in track] for track in made.graph.tracks}
    return FleetOutcome(
        title=title,
        submaps=len(submaps),
        placed=len(made.poses),
        good=len(judged) - len(wrong),
        good_kept=len(made.in_map - wrong),
        wrong=len(wrong),
        wrong_kept=len(made.in_map & wrong),
        before_m=ate_m(_odometry(made), truth),
        after_m=ate_m(made.poses, truth),
        clean_m=ate_m({n: T for s, poses in clean.items() for n, T in zip(names[s], poses, strict=True)}, truth),
        seconds=made.seconds,
    )


def _odometry(made: MapOfFleet) -> dict[str, Matrix4]:
    return {one.name: one.T_odom_submap for track in made.graph.tracks for one in track}


def _write(
    out: Path,
    outcomes: Sequence[FleetOutcome],
    submaps: Sequence[PlacedSubmap],
    made: MapOfFleet,
    judged: Mapping[str, bool],
) -> None:
    title = outcomes[-1].title
    (out / "fleet.md").write_text(table(outcomes))
    (out / "fleet.json").write_text(json.dumps([asdict(one) for one in outcomes], indent=1) + "\n")
    truth = {one.name: one.T_world_submap for one in submaps}
    placed = [one for track in made.graph.tracks for one in track if one.name in made.poses]
    stem = title.replace(" ", "-").replace("%", "percent")
    (out / f"{stem}.tum").write_text(tum_lines((one, made.poses[one.name]) for one in placed))
    (out / "truth.tum").write_text(tum_lines((one, truth[one.name]) for one in placed))
    loops = {loop.name: (loop.query, loop.match) for loop in made.graph.loops}
    figure = FleetFigure(
        sessions={track[0].name.split("/")[3]: [one.name for one in track] for track in made.graph.tracks},
        before=aligned(_odometry(made), truth),
        after=aligned(made.poses, truth),
        truth=truth,
        kept=[loops[name] for name in sorted(made.in_map)],
        set_aside=[pair for name, pair in loops.items() if judged.get(name, True) and name not in made.in_map],
        titles=(
            f"odometry, starts unknown: {outcomes[-1].before_m:.1f} m off",
            f"the map, wrong loops: {title}: {outcomes[-1].after_m:.2f} m off",
        ),
    )
    draw(figure, out / f"{stem}.png")
