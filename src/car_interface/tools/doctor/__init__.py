"""Examines a car, and reports what is wrong with the remedy. A file for each subject looks and judges."""
