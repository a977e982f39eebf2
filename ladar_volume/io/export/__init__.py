"""Results as files of other programs: one module a format; ``export_set`` is the door.

Everything is written from one record (:mod:`~ladar_volume.io.export.deliverable`), in the
coordinate system of :mod:`~ladar_volume.io.export.output_system`. Coordinates are doubles; formats
that hold 24 bits are written about a near origin that the file names.
"""
