"""Revisit as a service: one application layer behind REST and gRPC, worker processes, and a database that is the truth."""
