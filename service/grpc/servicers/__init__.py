"""The services of `revisit.v1`, one module per noun; each RPC parses, calls one use case and renders."""
