"""Cluster normal statistics and their saliency (paper III-C, III-E, Eq. 10-12)."""
