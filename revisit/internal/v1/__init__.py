"""Its messages and services of version 1."""
