"""Frames of the sensors (REP-105): static transforms as mounting, poses as transforms."""
