"""The command line ``ladar_volume VERB``: each verb is a module that reads its options, calls the
product and prints the result as a table or, with ``--json``, as JSON.

Public
- ``main.main``: finds the verb, runs it and returns the exit code; a refusal is one line.

Folders: ``arguments`` declares the options of each verb, and makes those that name a parameter from
its declaration; ``inputs`` reads files and settings; ``outputs`` writes files; ``tables`` prints;
``site`` has piles and trajectories; ``scale`` the runs by tiles and of many sites; ``studies`` the
published experiments; ``help`` examples and near misses. Nothing here is imported by other rooms
but ``api``, which offers the verbs as functions.
"""
