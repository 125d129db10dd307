"""What both servers do with the bytes of strangers before a use case is asked: connections, credentials, refusals."""
