"""The fused place descriptor: VLAD aggregation and fusion (paper III-D, III-E, Eq. 13-15)."""
