"""Post two submaps of one place over REST and see that they meet. The service: $REVISIT_URL, or port 8080 here."""

import numpy as np

from revisit import Client

client = Client()
town = client.create_map("rest-example", min_index_gap=1)
points = np.random.default_rng(7).uniform(-20, 20, (5000, 3)).astype(np.float32)
for day in ("monday", "tuesday"):
    session = client.create_session(town, day)
    operation = client.wait(client.post_submap(session, "start", points, T_odom_submap=np.eye(4), stamp_ns=1))
for hit in client.search(town, submap=operation.subject):
    print(f"{operation.subject} looks like {hit.submap}: {hit.similarity:.2f}")
