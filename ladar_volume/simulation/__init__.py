"""Surveys of scenes with closed-form volumes, ray-cast with errors drawn by own code.

Public:

- ``scenes``: scenes and their true volumes.
- ``platforms``, ``velodyne``: paths of a UAV and a rover; a VLP-16 that fires as the real one.
- ``survey``, ``drawn_errors``: one survey with its errors.
- ``bag``: a survey written as a recording.
- ``suited_parameters``: parameters a surveyor would choose for each scene.

It imports nothing of the pipeline, so that truth never leaks into it.
"""
