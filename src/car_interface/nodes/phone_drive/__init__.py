"""The phone_drive node, and its server."""
