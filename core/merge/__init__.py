"""Merging: neural maps of submaps that are placed to each other become one, and whether two of them may be at all.

evidence    limits, evidence and reasons against; changes, as values
candidates  which submaps of two maps may show the same place
joining     whether the loops between two groups of sessions allow joining them
fused       one neural map out of several
overlap     agreement of the surfaces of two placed groups
things      clusters of points that are more than noise
visits      what one drive saw of a place at one time
standing    the points that no later drive looked through
tiles       the surface of a square of a map
history     what changed from drive to drive, or between two days

Names are imported from their modules: the gateway reads `evidence` without loading a kernel.
"""
