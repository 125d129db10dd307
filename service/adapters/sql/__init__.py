"""The database: tables, repositories, transactions, migration. SQLite now; nothing but this package knows it."""
