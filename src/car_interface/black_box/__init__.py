"""The black box: what it keeps in memory, which stops have it written, and the folder that they go to."""
