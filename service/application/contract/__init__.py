"""What all use cases share: names, records, errors, and the ports to the outside."""
