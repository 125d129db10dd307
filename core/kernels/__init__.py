"""Compiled kernels, one module each, beside the plain formula they are proven equal to."""
