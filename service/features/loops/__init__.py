"""Loop closures: claims, verdicts, decisions, history."""
