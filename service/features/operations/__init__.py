"""Jobs as clients see them, and how workers run them."""
