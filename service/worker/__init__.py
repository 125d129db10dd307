"""Worker processes: they claim jobs, run the core and commit the results."""
