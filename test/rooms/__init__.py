"""Cars that drive blindly in random rooms, judged by room and car alone."""
