"""The engines that store: SQL statements, and this machine's own (SQLite, files, an index in memory)."""
