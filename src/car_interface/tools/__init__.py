"""What works on recordings, tables and the computer; of what drives, the rules of calibration_drive and first_check."""
