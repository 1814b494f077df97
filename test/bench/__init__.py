"""``./dev bench``: latency, CPU and memory, measured on this machine."""
