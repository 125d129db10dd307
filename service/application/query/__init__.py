"""Questions and their answers: searches, localisation, operations, downloads."""
