"""What changed between the drives of a map."""
