"""Who may do what: admission, API keys, callers, the audit log."""
