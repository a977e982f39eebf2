"""The package from Python: the verbs of the command line as functions of arrays and files
(``verbs``), and what they return (``answers``).
"""
