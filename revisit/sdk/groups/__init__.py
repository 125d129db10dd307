"""The groups of calls of a client: `client.maps`, `client.sessions`, `client.loops` and so on."""
