"""Whether clouds and poses can be what they claim: metres, upright, right-handed, in nanoseconds.

Nothing here refuses; a `Finding` says what was measured, what most likely causes it, and what to do. The thresholds are
set so that real drives and rooms have no findings (docs/how-to/check-a-recording.md).

`finding`, `numbers` and `ground` need NumPy alone, so that robots check what they send; `agreement` and `window` search
neighbours with SciPy.
"""
