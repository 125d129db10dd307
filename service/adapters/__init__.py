"""Implementations of the ports: SQL and its engine, files, memory, the recogniser, the index, tokens, traces, time."""
