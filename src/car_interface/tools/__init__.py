"""What works on recordings, tables and the computer; nothing here drives the car, except calibration_drive's rules."""
