"""``./dev bench``: everything that this package exists for, measured on the machine at hand."""
