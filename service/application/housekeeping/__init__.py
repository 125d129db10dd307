"""What keeps the service in order: sweeping, retention, the index, dead letters, health."""
