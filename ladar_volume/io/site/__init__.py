"""What an office knows of a site beside its points.

Public:

- ``outline_files``: outlines of piles from GeoJSON, Shapefile, GeoPackage, KML, DXF or WKT,
  placed in the points' system; ``outline_reading`` reads them.
- ``height_budget``: errors that heights of a survey share, from a file.
"""
