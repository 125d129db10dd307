"""Files on a local disk: blobs, durable writes, the room that is left, and what happens when the disk fails."""
