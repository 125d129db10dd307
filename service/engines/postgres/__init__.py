"""PostgreSQL as the database engine: connections, group commit, errors, migration (docs/decisions/0328).

It runs the statements of `engines.sql`, which know nothing of it. Nothing imports this package unless
REVISIT_DATABASE_URL names a server.
"""
