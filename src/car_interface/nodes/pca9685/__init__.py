"""The pca9685 node, and what only it needs."""
