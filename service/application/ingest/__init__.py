"""From scans and clouds to stored submaps."""
