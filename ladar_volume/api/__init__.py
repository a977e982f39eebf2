"""The package from Python: the verbs of the command line as functions of arrays and files.

Public, as ``ladar_volume.read``, ``.volume``, ``.filter`` and ``.replay``:

- ``verbs.read``: a point cloud file in metres, with its attributes.
- ``verbs.volume``: volume of a cloud, a mesh file or an array above a base, with its sigma.
- ``verbs.filter``: a cloud without outliers and with less noise.
- ``verbs.replay``: the volume of a recorded survey.
- ``answers``: what they return: numbers as fields, ``to_geodataframe`` and ``to_xarray``, and how
  an answer looks in a notebook.

Options are those of the command line, with ``_`` for ``-``; an unknown one names its nearest
neighbour. Numbers are those of the command line, since the same code runs. Errors are those of
``model.errors``.

Within: ``frames`` (tables and grids of other libraries, which are loaded when they are asked for).
docs/quick_start.md shows every function.
"""
