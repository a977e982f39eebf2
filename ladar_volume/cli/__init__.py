"""The command line: ``main`` finds the verb, each verb is a module that reads options, calls
one function of the product and prints its result.
"""
