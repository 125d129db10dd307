"""Values that every part of the service shares: ids, records, states, errors, limits, rules."""
