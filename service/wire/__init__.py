"""The one wire form: use-case views as protobuf messages, and the same messages as JSON.

names      resource names (`maps/{map}/sessions/{session}`) to keys
requests   a request message to what the use case takes                     used by gRPC
answers    a view to the fields of its message, each written once           used by both transports
json_form  the fields of a message as ProtoJSON                             used by REST
openapi    the messages as OpenAPI schemas, with the comments of the proto  used by REST

This package knows `revisit.v1` and the use cases, and no transport.
"""
