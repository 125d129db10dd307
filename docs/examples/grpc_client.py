"""Stream two drives through a made-up yard over gRPC, see how they meet. The service: $REVISIT_GRPC, or here."""

import numpy as np

from revisit import Client
from revisit.core.geometry.se3 import apply, from_yaw, inverse

rng = np.random.default_rng(1)
ground = rng.uniform((-25, -25, -1.7), (25, 25, -1.7), (30000, 3))
walls = [((-12, 14), (6, 14.2)), ((10, -10), (19, -9.8)), ((17, 2), (17.2, 13)), ((-15, -9), (-14.8, -2))]
yard = np.vstack([ground, *(rng.uniform((*low, -1.7), (*high, 4.0), (6000, 3)) for low, high in walls)])

client = Client.grpc()
town = client.create_map("streamed-yard")
for day, T_yard_odom in (("monday", from_yaw(0.0, (-5.0, 0.0, 0.0))), ("tuesday", from_yaw(2.0, (4.0, -3.0, 0.0)))):
    session = client.create_session(town, day)
    with client.stream(session) as stream:
        for metre in range(stream.committed_seq, 12):
            T_odom_sensor = from_yaw(0.0, (metre, 0.0, 0.0))
            seen = apply(inverse(T_yard_odom @ T_odom_sensor), yard[metre::12])
            stream.send(seen, T_odom_sensor, stamp_ns=metre * 10**9)
    client.finish_session(session)
for submap in client.list_submaps(session):
    client.wait(submap.operation)
for loop in client.loop_closures(town):
    print(
        f"{loop.query} is where {loop.match} was, score {loop.score:.2f}", loop.T_match_query.round(2) + 0.0, sep="\n"
    )
