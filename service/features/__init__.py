"""One room a feature.

`calls.py` runs in the gateway and `job.py` in a worker; `rows.py` reads and writes rows, `rules.py` is pure.
"""
