"""The Python SDK: everything behind `from revisit import Client`. It needs no part of the service."""
