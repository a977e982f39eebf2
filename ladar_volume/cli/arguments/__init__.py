"""What each verb takes: options, apart from the work, so that a command line is read (and refused)
without a compiler or SciPy. A verb's work, in the module of the same name, is loaded to run it.
"""
