"""Verification of a loop candidate: correspondences, start, registration, evidence, verdict (paper III-E, end)."""
