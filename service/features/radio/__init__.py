"""Readings of radio: post them, and the fingerprints of submaps that are made of them."""
