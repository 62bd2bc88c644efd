"""The training loss (``sfsnet``) and its reconstruction term as one Dr.Jit kernel, with readable
references beside it.
"""
