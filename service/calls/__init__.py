"""The functions that answer the calls, each named as its RPC: a request message to a use case, its view to fields.

The rooms are those of the use cases. REST and gRPC both come here (`service.calls.uses`); they add bytes only.
"""
