"""Stream a straight drive over gRPC and list what it became: `python docs/examples/grpc_client.py [HOST:PORT]`."""

import sys

import numpy as np

from revisit import Client

client = Client.grpc(sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1:8090")
session = client.create_session(client.create_map("grpc-example"), "monday")
points = np.random.default_rng(7).uniform(-20, 20, (5000, 3)).astype(np.float32)
with client.stream(session) as stream:
    for second in range(stream.committed_seq, 25):
        T_odom_sensor = np.eye(4)
        T_odom_sensor[0, 3] = second
        stream.send(points, T_odom_sensor, stamp_ns=second * 10**9)
client.finish_session(session)
for submap in client.list_submaps(session):
    print(submap.name, submap.state, submap.scan_count, "scans")
