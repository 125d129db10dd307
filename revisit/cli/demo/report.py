"""Results of the demo as tables: some loops with their errors, and the figures against their targets."""

from __future__ import annotations

import math

from rich.console import Console
from rich.table import Table

from revisit.core.geometry import se3
from revisit.evaluation.demo import LoopReport, MapReport, RobotTrack

SHOWN_LOOPS = 12


def show(report: LoopReport, console: Console) -> None:
    """Print some loops with their errors, then the figures against their targets."""
    table = Table(title=f"{len(report.loops)} accepted loop closures, some of them")
    for heading in ("query", "match", "truly apart", "position error", "rotation error"):
        named = heading in ("query", "match")
        table.add_column(heading, justify="left" if named else "right", overflow="fold", no_wrap=False)
    step = max(1, len(report.loops) // SHOWN_LOOPS)
    for judged in report.loops[::step][:SHOWN_LOOPS]:
        table.add_row(
            _short(judged.loop.query), _short(judged.loop.match), f"{judged.distance_m:.1f} m",
            f"{judged.error_m:.2f} m", f"{judged.error_deg:.2f} deg",
        )  # fmt: skip
    console.print(table)
    console.print(_figures(report))


def show_map(report: MapReport, console: Console) -> None:
    """Print the gain of one map for each robot: its errors before and after, and its correction."""
    table = Table(title=f"One map of both robots: {_resting(report)}")
    table.add_column("robot", overflow="fold")
    for heading in ("way", "odometry off", "map off", "correction: x, y, yaw"):
        table.add_column(heading, justify="right")
    for track in report.tracks:
        table.add_row(*_track(track))
    console.print(table)
    better = "[green]reached[/]" if report.better else "[red]missed[/]"
    console.print("Off: absolute trajectory error (after the best rigid fit), and the farthest from the truth.")
    console.print(f"Trajectory error of both in one map: {report.ate_m:.2f} m, less than odometry alone: {better}")


def _resting(report: MapReport) -> str:
    return f"{report.loops_in_map} loop closures hold it, {report.loops_set_aside} are set aside"


def _track(track: RobotTrack) -> tuple[str, ...]:
    x, y, _ = track.T_map_odom[:3, 3]
    return (
        track.robot,
        f"{track.way_m[-1]:.0f} m",
        f"{track.odometry_ate_m:.2f} m, at most {track.odometry_off_m.max():.2f} m",
        f"{track.map_ate_m:.2f} m, at most {track.map_off_m.max():.2f} m",
        f"{x:.1f} m, {y:.1f} m, {math.degrees(se3.yaw(track.T_map_odom)):.1f} deg",
    )


def _figures(report: LoopReport) -> Table:
    targets = report.targets
    table = Table(title="Against the known truth")
    for heading in ("figure", "value", "target", ""):
        table.add_column(heading, overflow="fold")
    share = f"{report.revisits_found} of {report.revisits} ({100 * report.found_share:.1f} %)"
    pose = f"{report.median_m:.2f} m, {report.median_deg:.2f} deg"
    rows = [
        (f"true revisits found (within {targets.revisit_m:.0f} m of an earlier pass)", share,
         f">= {100 * targets.found:.0f} %", report.found_share >= targets.found),
        ("false loops accepted", str(report.false_loops), "0", report.false_loops == 0),
        ("median pose error", pose, f"<= {targets.median_m} m, {targets.median_deg} deg",
         report.median_m <= targets.median_m and report.median_deg <= targets.median_deg),
    ]  # fmt: skip
    for name, value, target, good in rows:
        table.add_row(name, value, target, "[green]reached[/]" if good else "[red]missed[/]")
    return table


def _short(name: str) -> str:
    parts = name.split("/")
    return f"{parts[3]}/{parts[5]}" if len(parts) > 5 else name
