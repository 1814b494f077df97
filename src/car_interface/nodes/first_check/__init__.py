"""The first_check node."""
