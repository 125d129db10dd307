"""gRPC: parse, call a use case, render. `service.grpc.server.create_server` is the way in."""
