"""Whether a request is accepted now: rates, slots, bytes, backlog, storage."""
