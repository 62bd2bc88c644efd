"""Real spherical harmonics: basis to order 8, light coefficients, projection and rotation.

``coefficients`` has the two forms of a light, ``Radiance`` and ``Shading``; ``kernel`` the clamped cosine
that turns one into the other; ``basis`` evaluates in NumPy, ``basis_torch`` in torch, ``polynomials`` in any.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
