"""first_check's questions, what their answers mean, and what is written."""
