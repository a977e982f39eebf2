"""Point cloud files by the ending of their name. ``cloud_files`` is the door; each format has
a module of its own.
"""
