"""The doctor: looks at a car and says what is wrong, with the remedy."""
