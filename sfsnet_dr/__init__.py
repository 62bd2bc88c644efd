"""Physically based inverse rendering of faces: Mitsuba 3 ground truth, SH shading models, and SfSNet.

    >>> import sfsnet_dr as sf
    >>> light = sf.sample_light(seed=1)
    >>> image = sf.path_trace(sf.build_subject("sphere"), light, samples=4)

============================  ==========================================================================
photographs                   ``load_model``, ``decompose``, ``Decomposition``, ``relight``, ``shade``
scenes and light              ``load_scene``, ``build_subject``, ``Light``, ``sample_light``
rendering                     ``path_trace``, ``render_aovs``, ``Transport``, ``relight_transport``
training data                 ``synthesize``, ``load_faces``, ``RelitFaces``
networks and loss             ``SfSNet``, ``SkipNet``, ``SkipNetPlus``, ``sfsnet_loss``, ``train``
measuring                     ``metrics``, ``validate``, ``find_renderer``, ``Record``
spherical harmonics           ``sh``
============================  ==========================================================================

Every name is loaded when it is first used, so that ``import sfsnet_dr`` takes milliseconds; torch and Mitsuba
are loaded by what needs them. ``__init__.pyi`` says where each name comes from.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
