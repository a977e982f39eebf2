"""Verbs for more than one cloud, or for one that is larger than the memory."""
