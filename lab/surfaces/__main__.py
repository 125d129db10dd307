"""`python -m lab.surfaces`: how near stored neural maps come to the true surface, by kind of field and by spacing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lab.command_line import run
from revisit.cli.output import say


def surface(
    out: Annotated[Path, typer.Option(help="Folder for the tables, the picture and unpacked recordings.")] = Path(
        "out/surface"
    ),
    count: Annotated[int, typer.Option(min=1, help="Submaps of most groups of scenes.")] = 2,
) -> None:
    """How near stored neural maps come to the true surface, and how many bytes they take."""
    from lab.surfaces import kinds
    from revisit.evaluation.surfaces.scenes import scene_groups

    out.mkdir(parents=True, exist_ok=True)
    groups = scene_groups(out, count)
    rows = list(kinds.compare_kinds(groups, say))
    (out / "kinds.md").write_text(kinds.kinds_table(rows))
    street = next((name for name in groups if "real" in name), list(groups)[-1])
    curve = list(kinds.compare_spacings(street, groups[street], say))
    (out / "spacings.md").write_text(kinds.kinds_table(curve))
    kinds.draw_curve(curve, out / "rate-distortion.png")
    say(f"{out / 'kinds.md'}, {out / 'spacings.md'} and {out / 'rate-distortion.png'}")


if __name__ == "__main__":
    run(surface)
