"""Revisit as a service: one application layer behind REST and gRPC, worker processes, a database that is the truth."""

from importlib import metadata

try:
    VERSION = metadata.version("revisit-loops")
except metadata.PackageNotFoundError:
    VERSION = "0+uninstalled"

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
}
"""One thread for each library in each process (torch and FAISS go by OpenMP's): processes share the cores out."""
