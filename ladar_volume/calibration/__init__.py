"""Calibration constants with their covariance.

Public:

- ``selfcal.calibrate``: boresight, lever arms and clock from overlapping strips.
- ``repeats``: sigmas from repeated measurements (seed 004 section 5.1.2).

Within: ``flight``, ``strip_patches``, ``strip_adjustment``, ``navigation_drift``.
"""
