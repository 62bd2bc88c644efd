"""Every number that compares two things: normals, images, lights, and noisy images with each other.

``normals`` and ``image`` measure predictions against truth; ``noise_free`` a model against noisy references;
``equivalence`` tells whether two noisy images agree; ``bootstrap`` gives intervals.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
