"""Training of what is shipped in core/weights: the SDF decoder and the codebooks."""
