"""Revisit as a service: one application layer behind REST and gRPC, worker processes, a database that is the truth."""

from importlib import metadata

try:
    VERSION = metadata.version("revisit-loops")
except metadata.PackageNotFoundError:
    VERSION = "0+uninstalled"
