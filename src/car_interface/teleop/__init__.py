"""Gamepad and keyboard: what a person asks for, and whether a deadman is held."""
