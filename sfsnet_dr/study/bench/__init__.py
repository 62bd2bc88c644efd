"""Timings of the fast kernels against their twins, in one run."""
