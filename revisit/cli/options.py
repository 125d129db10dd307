"""Options that several commands take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Http = Annotated[str, typer.Option(help="The service: http://HOST:PORT, or HOST. By default REVISIT_HTTP, or here.")]
Grpc = Annotated[
    str,
    typer.Option(help="HOST:PORT of its gRPC side, where the service tells another one. Or REVISIT_GRPC."),
]
Home = Annotated[Path | None, typer.Option(help="Directory of the database and the blobs.")]
Json = Annotated[bool, typer.Option("--json", help="Answer as JSON.")]
Yes = Annotated[bool, typer.Option("--yes", help="Do not ask.")]
MapName = Annotated[str, typer.Option("--map", help="Id of the map.")]
Tau = Annotated[float | None, typer.Option(help="Metres per submap.")]
Stride = Annotated[float | None, typer.Option(help="Metres between submap starts.")]
LeaveDistance = Annotated[
    float | None, typer.Option(help="So far a drive leaves a place before it may come back to it, m.")
]
PositiveRadius = Annotated[float | None, typer.Option(help="Submaps nearer than this are the same place, m.")]

RECORDINGS = (
    "auto (by what is there), kitti, kitti360, mulran, nclt, clouds (pcd or ply with TUM or KITTI poses), "
    "rosbag2 (mcap or db3) or rosbag1 (bag)."
)

HTTP, GRPC = "", ""
"""Not given: `revisit.sdk.addresses` says where the service is then."""
