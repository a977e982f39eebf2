"""Mesh files by the ending of their name. ``mesh_files`` is the door; each format has a
module of its own.
"""
