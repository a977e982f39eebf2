"""Frames of the graph (REP-105): static transforms as mounting, the pose as transforms."""
