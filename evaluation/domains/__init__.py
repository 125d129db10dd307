"""Domains: worlds built in different ways, so that no choice fits the one generator it was made on.

vegetation, relief               what grows and what it stands on
verge, facades, resimulation     worlds: made up beside any way; real facades; real surfaces from other paths
drives                           a world driven along legs, as a recording
catalogue                        every domain by name
evaluation, report               recognition in each of them, and the table with the worst one
"""
