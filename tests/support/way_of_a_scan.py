"""Print the modules of the project whose code runs between a scan's message and its acknowledgement, one a line.

A stream of three scans runs over SQLite in this process. The third is traced in every thread: each function of ours
that is called counts for its module. Generated stubs and imports do not count.
"""

from __future__ import annotations

import asyncio
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
SCANS = 3


class Trace:
    """Notes the modules of the project while it is `on`."""

    def __init__(self) -> None:
        self.on = False
        self.modules: set[str] = set()

    def __call__(self, frame: Any, _event: str, _argument: Any) -> None:
        """See `sys.settrace`."""
        name = frame.f_code.co_filename
        if self.on and name.startswith(str(ROOT)) and "/.venv/" not in name and frame.f_code.co_name != "<module>":
            self.modules.add(Path(name).resolve().relative_to(ROOT).as_posix())


trace = Trace()
threading.settrace(trace)

from revisit.sdk.clouds import encoded  # noqa: E402  # threads that imports start are traced too
from revisit.service.adapters.files.disk import Disk  # noqa: E402
from revisit.service.application.access import callers  # noqa: E402
from revisit.service.grpc.servicers import ingest  # noqa: E402
from revisit.v1 import cloud_pb2, geometry_pb2, ingest_pb2  # noqa: E402
from tests.support.service_world import SESSION, cloud_points, open_session, sqlite_world  # noqa: E402

ingest.DRAIN_POLL_S = 3600.0


def scan(seq: int) -> ingest_pb2.StreamScansRequest:
    """A scan as the SDK sends it, taken half a metre after the one before."""
    made = encoded(cloud_points(seq))
    cloud = cloud_pb2.Cloud(encoded=cloud_pb2.EncodedCloud(data=made.data, content_type=made.content_type))
    where = geometry_pb2.Vector3(x=0.5 * seq)
    pose = geometry_pb2.Transform(rotation=geometry_pb2.Quaternion(w=1.0), translation=where)
    return ingest_pb2.StreamScansRequest(
        scan=ingest_pb2.Scan(seq=seq, stamp_ns=100 * seq, t_odom_sensor=pose, cloud=cloud)
    )


async def stream(home: Path) -> None:
    """Send the scans, each after the answer to the one before."""
    sys.settrace(trace)
    world, acknowledged = sqlite_world(home, Disk(home, reserve_bytes=0)), asyncio.Event()
    callers.enter(callers.ANYONE)
    await open_session(world)

    async def requests() -> Any:
        yield ingest_pb2.StreamScansRequest(open=ingest_pb2.Open(session=SESSION.name))
        for seq in range(1, SCANS + 1):
            message, trace.on = scan(seq), seq == SCANS
            acknowledged.clear()
            yield message
            await acknowledged.wait()

    async for answer in ingest.IngestServicer(world.use_cases).StreamScans(requests(), None):
        if answer.WhichOneof("response") == "ack":
            trace.on = False
            acknowledged.set()
    world.context.transactions.close()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        asyncio.run(stream(Path(folder)))
    ours = (name for name in trace.modules if not name.startswith(("tests/", "revisit/v1/")))
    print("\n".join(sorted(ours)))
