"""The protocols of the recognition benchmark: the same submaps and the same queries for every method.

towns                the simulated drives and their seeds
ground_truth         which map submaps a query may be matched with, and which of them show its place
comparison           all methods on one set of queries
experiment           the results of one protocol on one sequence, as numbers in a file
directions           in which direction a place is passed again
benchmark_plan       which experiments make up the benchmark
sequential_baseline  MapClosures, which needs the submaps of a drive in their order
scan_baseline        BoW3D, which needs single scans and their lines
"""
