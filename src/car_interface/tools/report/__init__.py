"""The page about a drive: a summary of a recording, its plots, its HTML."""
