"""Calibration: numbers of a drive in, tables with their confidence out. Pure numpy and scipy."""
