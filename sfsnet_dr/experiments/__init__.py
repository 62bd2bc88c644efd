"""Experiments, one folder each.

``config`` says what to do, ``run`` does it, ``measure`` and ``records`` give the numbers, ``page`` shows
them.
"""
