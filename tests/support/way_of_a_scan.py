"""Print the modules of the project whose code runs for a stream of scans, one a line: leg, space, module.

The server of the product, with all its interceptors, listens on a port of this process, over SQLite; the client speaks
to it over a real channel with the generated stub. Three legs are traced in every thread: "open", from the call to the
answer that opens the stream, "scan", from the third scan to its acknowledgement, and "end", from there to the end of
the call. Each function of ours that is called counts for its module. Generated stubs and imports do not count.
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
    """Notes the modules of the project by leg, while there is one."""

    def __init__(self) -> None:
        self.leg = ""
        self.crossed: set[tuple[str, str]] = set()

    def __call__(self, frame: Any, _event: str, _argument: Any) -> None:
        """See `sys.settrace`."""
        name = frame.f_code.co_filename
        if self.leg and name.startswith(str(ROOT)) and "/.venv/" not in name and frame.f_code.co_name != "<module>":
            self.crossed.add((self.leg, Path(name).resolve().relative_to(ROOT).as_posix()))


SETTLE_S = 0.3

trace = Trace()
threading.settrace(trace)

import grpc  # noqa: E402
import structlog  # noqa: E402

from revisit.service.features.keys import admission  # noqa: E402

# Once a second the credential of a stream is checked again: on a slow machine while a scan is under way.
admission.STREAM_RECHECK_S = 3600.0

from revisit.sdk.clouds import encoded  # noqa: E402  # threads that imports start are traced too
from revisit.service.engines.local.files.disk import Disk  # noqa: E402
from revisit.service.features.ingest import calls as ingest_calls  # noqa: E402
from revisit.service.grpc import scan_streams  # noqa: E402
from revisit.service.grpc.server import create_server  # noqa: E402
from revisit.service.metrics import RequestMetrics  # noqa: E402
from revisit.v1 import cloud_pb2, geometry_pb2, ingest_pb2, ingest_pb2_grpc  # noqa: E402
from tests.support.service_world import SESSION, cloud_points, open_session, sqlite_world  # noqa: E402

# So are the two polls of an open stream.
scan_streams.DRAIN_POLL_S = ingest_calls.ENDS_WITHIN_S = 3600.0


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
    """Open a stream, send the scans, each after the answer to the one before, and end it."""
    sys.settrace(trace)
    world = sqlite_world(home, Disk(home, reserve_bytes=0))
    await open_session(world)
    server = create_server(world.use_cases, requests=RequestMetrics())
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    async with grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel:
        trace.leg = "open"
        call = ingest_pb2_grpc.IngestServiceStub(channel).StreamScans()
        await call.write(ingest_pb2.StreamScansRequest(open=ingest_pb2.Open(session=SESSION.name)))
        await call.read()
        for seq in range(1, SCANS + 1):
            trace.leg = ""
            message = scan(seq)
            trace.leg = "scan" if seq == SCANS else ""
            await call.write(message)
            await call.read()
        trace.leg = ""
        await asyncio.sleep(SETTLE_S)  # the thread of the writer is past the acknowledgement then
        trace.leg = "end"
        await call.done_writing()
        await call.code()
        trace.leg = ""
    await server.stop(None)
    world.context.transactions.close()


if __name__ == "__main__":
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
    with tempfile.TemporaryDirectory() as folder:
        asyncio.run(stream(Path(folder)))
    ours = ((leg, name) for leg, name in trace.crossed if not name.startswith(("tests/", "revisit/v1/")))
    print("\n".join(f"{leg} {name}" for leg, name in sorted(ours)))
