"""The demo's tables in a narrow terminal."""

from __future__ import annotations

import io
from types import SimpleNamespace

from rich.console import Console

from revisit.cli.demo.report import show


def test_the_names_of_submaps_are_never_cut():
    names = {
        "query": "maps/demo/sessions/visitor/submaps/scans-301-412",
        "match": "maps/demo/sessions/patrol/submaps/s-77",
    }
    judged = SimpleNamespace(loop=SimpleNamespace(**names), distance_m=1.0, error_m=0.1, error_deg=0.1)
    targets = SimpleNamespace(revisit_m=5.0, found=0.9, median_m=0.5, median_deg=1.0)
    report = SimpleNamespace(
        loops=[judged], targets=targets, revisits_found=1, revisits=1, found_share=1.0, median_m=0.1, median_deg=0.1,
        false_loops=0,
    )  # fmt: skip
    printed = io.StringIO()
    show(report, Console(file=printed, width=64))
    rows = [line.split("│") for line in printed.getvalue().splitlines() if line.startswith("│")]
    assert "visitor/scans-301-412" in "".join(row[1].strip() for row in rows)
    assert "patrol/s-77" in "".join(row[2].strip() for row in rows)
