"""SQLite as the database engine: connections and pragmas, the writer lock, group commit, errors, migration, backup.

It runs the statements of `engines.sql`, which know nothing of it. Why SQLite is driven as it is: docs/decisions/0033.
"""
