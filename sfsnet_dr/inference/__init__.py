"""A photograph in, a decomposition out: ``decompose``, ``relight``, ``outputs``; ``methods`` and
``baselines`` for evaluation.
"""
