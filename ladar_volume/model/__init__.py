"""Records, parameters and errors: what flows from stage to stage and what steers it.

Public:

- ``records``: the records of the stages; a point and all that is known of it travel in one.
- ``parameters`` and ``parameter``: one frozen class per stage, the only source of a default, a
  unit, a bound and a help text.
- ``errors``: one root, one base per room; each leaf keeps the offending value.
- ``losses``: what was dropped, counted by reason.
- ``verdict``: sound, or doubtful with each reason in one sentence.

Nothing here reads files, clocks or ROS.
"""
