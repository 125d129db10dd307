"""This machine's engine: SQLite, files, the index in the process, the clock of one boot."""
