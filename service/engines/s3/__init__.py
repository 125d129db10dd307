"""Blobs in a bucket of an S3 server, through obstore (extra `cluster`); only `composition` imports this package."""
