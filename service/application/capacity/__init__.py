"""What the service accepts now: rate limits, clouds and streams in flight, the backlog of jobs."""
