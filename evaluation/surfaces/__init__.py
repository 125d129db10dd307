"""How near the stored neural map comes to the true surface.

zero_level   the surface where a stored field is zero, as a fine mesh
metrics      errors of that surface both ways, and of its normals
scenes       submaps with a truth of their own: analytic, simulated, and real with scans held out
bench        all of it as one table
"""
