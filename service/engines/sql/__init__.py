"""Rows in an SQL database: tables, statements, repositories, the unit of work.

Nothing here knows which database runs the statements.
Questions that standard SQL leaves open go to `engine.DatabaseEngine`. Connections, transactions, locks, errors,
migrations and backups belong to the package of the engine, which stands beside this one.
"""
