"""The accuracy of a volume before the flight.

Public:

- ``prediction.predict``: the survey's own propagation on a planned path and scene.
- ``sensor_choice``: which sensors, and how high.
- ``planned_path``, ``planned_scene``: lanes, and a pile or pit of simple shape.
"""
