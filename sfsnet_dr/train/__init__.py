"""The training loop: from a recipe and faces to weights, in one process or several.

``config`` has every setting, ``trainer`` the loop, ``step`` one step of it, ``checkpoint`` the exact resume,
``sources`` the real faces that join the rendered ones, ``averaging`` the mean of checkpoints.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
