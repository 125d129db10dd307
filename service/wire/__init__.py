"""The one wire form: use-case views as protobuf messages, and the same messages as JSON.

names      resource names (`maps/{map}/sessions/{session}`) to keys
requests   parts of request messages as the use cases take them
fields     views to the fields of their messages, by name
rendering  long answers beside the event loop
json_form  the fields of a message as ProtoJSON                             used by REST
openapi    the messages as OpenAPI schemas, with the comments of the proto  used by REST

This package knows `revisit.v1` and the use cases, and no transport.
"""
