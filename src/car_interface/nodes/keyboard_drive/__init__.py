"""The keyboard_drive node, and what only it needs."""
