"""`revisit reembed`: maps of an older model get the descriptors of the installed one."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.extras import needs
from revisit.cli.offline import use_cases_on
from revisit.cli.options import Home, Json
from revisit.cli.output import emit_json, emit_table, progress_bar, refuse, reporter, say

if TYPE_CHECKING:
    from revisit.service.features.recognition.reembedding import Reembedded


@needs("service")
def reembed(
    maps: Annotated[
        list[str] | None,
        typer.Argument(help="Ids of maps, described again in any case; by default all of another model."),
    ] = None,
    home: Home = None,
    json: Json = False,
) -> None:
    """Describe the submaps of older maps again with the installed model, from their stored neural maps.

    A submap with a damaged neural map, or one of a former form, is described from its scans: name its map for that.
    Each map changes in one step at its end; an interrupted run goes on where it ended. Loop closures stay as they are.
    """
    from revisit.service.composition import offline_reembedding
    from revisit.service.settings_loading import load_settings

    with use_cases_on(home):
        pass  # the database is there and of this version
    done = []
    with offline_reembedding(load_settings(home)) as work, progress_bar(quiet=json) as bar:
        report = reporter(bar)
        for record in work.named_maps(maps) if maps else work.stale_maps():
            done.append(work.reembed(record, partial(report, f"map {record.map_id}")))
    if json:
        emit_json([_as_json(one) for one in done])
    elif done:
        columns = ("map", "from", "to", "submaps", "from scans", "failed")
        emit_table("Described again", columns, [_row(one) for one in done])
    else:
        say("every map is of the installed model")
    if any(one.failures for one in done):
        raise refuse("some submaps could not be described: they have FAILED, with the reason")


def _row(done: Reembedded) -> tuple[object, ...]:
    old = done.map.model_version
    return done.map.map_id, old, done.model_version, done.submaps, done.from_scans, len(done.failures)


def _as_json(done: Reembedded) -> dict[str, object]:
    return {
        "map": done.map.map_id, "tenant": done.map.tenant, "from": done.map.model_version, "to": done.model_version,
        "submaps": done.submaps, "from_scans": done.from_scans, "failures": done.failures,
    }  # fmt: skip
