"""What a worker does: describe a submap, recall, verify, commit."""
