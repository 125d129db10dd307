"""Resources as clients see them, and lists of them."""
