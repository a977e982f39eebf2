"""Closed bodies of a georeferenced survey.

Public:

- ``survey_bodies.bodies_of_survey``: the bodies within a survey's returns, each with the whole
  budget.
- ``survey_gradient.on_survey``: a gradient by any points of a surface as one by the survey's own.
"""
