"""What the demo found, as tables: some loops with their errors, and the figures against their targets."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from revisit.evaluation.demo import LoopReport

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
