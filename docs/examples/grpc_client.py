"""Stream a straight drive over gRPC and list its submaps. The service: $REVISIT_GRPC, or port 8090 here."""

import numpy as np

from revisit import Client
from revisit.core.geometry.se3 import from_yaw

client = Client.grpc()
session = client.create_session(client.create_map("grpc-example"), "monday")
points = np.random.default_rng(7).uniform(-20, 20, (5000, 3)).astype(np.float32)
with client.stream(session) as stream:
    for second in range(stream.committed_seq, 25):
        stream.send(points, T_odom_sensor=from_yaw(0.0, (second, 0.0, 0.0)), stamp_ns=second * 10**9)
print([submap.name for submap in client.list_submaps(client.finish_session(session))])
