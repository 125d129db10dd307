"""Authentication, API keys."""
