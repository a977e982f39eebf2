"""Tables on the screen, one module for each kind of result.

``result_table`` (a survey's volume), ``volume_table`` (cut and fill), ``diff_table`` (volume
between two scans). They print records and compute nothing.
"""
