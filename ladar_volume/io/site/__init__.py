"""What an office knows of a site beside its points.

Public:

- ``outline_files``: outlines of piles from GeoJSON, Shapefile, GeoPackage, KML, DXF or WKT.
- ``height_budget``: errors that heights of a survey share, from a file.
"""
