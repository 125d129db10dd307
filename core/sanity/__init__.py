"""Plausibility of clouds and poses: metres, upright, right-handed, in nanoseconds.

Nothing here refuses; a `Finding` has the measurement, the likely cause and the advice. The thresholds are
set so that real drives and rooms have no findings (docs/how-to/check-a-recording.md).

`finding`, `numbers` and `ground` need NumPy alone, so that robots check their own data; `agreement` and `window` search
neighbours with SciPy.
"""
