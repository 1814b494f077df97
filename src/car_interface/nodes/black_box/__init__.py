"""The black_box node, and what only it needs."""
