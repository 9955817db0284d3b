"""A user's own recordings: read them, inspect them, and choose parameters with them."""
