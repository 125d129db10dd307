"""How much is accepted: rate limits, quotas, clouds in flight."""
