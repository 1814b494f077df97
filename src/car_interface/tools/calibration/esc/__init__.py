"""What an ESC is like, by a drive in which a person made it drive, brake and reverse."""
