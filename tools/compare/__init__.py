"""Train the same thing several ways, or several things the same way, and write a table beside them."""
