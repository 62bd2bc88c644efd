"""Axes, frames and units that every part shares. The pins are in ``tests/core/test_conventions.py``.

Convention:
    Camera frame = world frame of every scene: right-handed, x to the image right, y up, z toward the
    viewer. The camera sits on the positive z axis and looks along -z; faces are moved, cameras are not,
    so that normals and light directions need no further rotation.
    Row 0 of an image is its top row; the centre of pixel (row i, column j) is x = j + 1/2, y = i + 1/2.
    Images and albedo are linear, Rec. 709 primaries, D65.
"""

from __future__ import annotations

from typing import Final

#: Width and height of the canonical face frame, in pixels.
FACE_SIZE: Final = 128

#: Eye centres (x right, y down, pixels) of the canonical frame; "image left" is the viewer's left.
EYE_IMAGE_LEFT: Final = (45.0, 48.0)
EYE_IMAGE_RIGHT: Final = (83.0, 48.0)

#: Distance between the eye centres in the canonical frame, in pixels.
EYE_DISTANCE: Final = EYE_IMAGE_RIGHT[0] - EYE_IMAGE_LEFT[0]

#: Row near which the chin of an average face lies in the canonical frame, in pixels.
CHIN_ROW: Final = 118.0

#: The network's light: order-2 shading coefficients, 9 for red, 9 for green, 9 for blue.
LIGHT_ORDER: Final = 2
LIGHT_SIZE: Final = 27

#: Squared length below which a normal is treated as having this length when it is normalised.
NORMAL_EPSILON: Final = 1e-12
