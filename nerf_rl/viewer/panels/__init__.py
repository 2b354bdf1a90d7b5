"""Parts of a page that show or set one thing."""
