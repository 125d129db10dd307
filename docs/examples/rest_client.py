"""Post two submaps of one place over REST and see that they meet: `python docs/examples/rest_client.py [URL]`."""

import sys

import numpy as np

from revisit import Client

client = Client(sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:8080")
town = client.create_map("rest-example", min_index_gap=1)
points = np.random.default_rng(7).uniform(-20, 20, (5000, 3)).astype(np.float32)
for day in ("monday", "tuesday"):
    session = client.create_session(town, day)
    operation = client.wait(client.post_submap(session, "start", points, np.eye(4), stamp_ns=1))
    print(operation.subject, operation.state)
for hit in client.search(town, submap=operation.subject):
    print(f"{hit.submap} looks like it: {hit.similarity:.2f}")
