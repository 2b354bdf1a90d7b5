"""Repositories on the Hugging Face Hub: their addresses, and what is fetched from and committed to them."""
