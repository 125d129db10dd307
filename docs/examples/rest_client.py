"""Show a made-up yard on two days, from two places, and see how they meet. The service: $REVISIT_HTTP or here."""

import numpy as np

from revisit import Client
from revisit.core.geometry.se3 import apply, from_yaw, inverse

rng = np.random.default_rng(1)
ground = rng.uniform((-25, -25, -1.7), (25, 25, -1.7), (30000, 3))
walls = [((-12, 14), (6, 14.2)), ((10, -10), (19, -9.8)), ((17, 2), (17.2, 13)), ((-15, -9), (-14.8, -2))]
yard = np.vstack([ground, *(rng.uniform((*low, -1.7), (*high, 4.0), (6000, 3)) for low, high in walls)])

client = Client()
town = client.create_map("yard")
for day, T_yard_robot in (("monday", np.eye(4)), ("tuesday", from_yaw(np.radians(40), (3.0, 0.0, 0.0)))):
    seen = apply(inverse(T_yard_robot), yard)  # by the robot, which does not know where in the yard it stands
    session = client.create_session(town, day)
    client.wait(client.post_submap(session, "start", seen, T_odom_submap=np.eye(4), stamp_ns=1))
for loop in client.loop_closures(town):
    print(
        f"{loop.query} is where {loop.match} was, score {loop.score:.2f}", loop.T_match_query.round(2) + 0.0, sep="\n"
    )
