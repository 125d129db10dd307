"""Merging: neural maps of submaps that are placed to each other become one, and whether two of them may be at all.

evidence    limits, evidence and reasons against; changes, as values
candidates  which submaps of two maps may show the same place
joining     whether the loops between two groups of sessions allow joining them
overlap     agreement of the surfaces of two placed groups
changes     things that vanished or appeared between two days
fused       one neural map out of several

Names are imported from their modules: the gateway reads `evidence` without loading a kernel.
"""
