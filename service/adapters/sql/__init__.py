"""The database: tables, repositories, transactions. SQLite now; nothing but this package knows it."""
