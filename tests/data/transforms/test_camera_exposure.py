from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from sfsnet_dr.data.transforms.camera import USUAL, metering_gain
from sfsnet_dr.inference.decompose import run_network
from sfsnet_dr.inference.photograph import Photograph
from sfsnet_dr.models.base import Network, NetworkOutput


def test_what_is_usual_stays_and_the_rest_is_brought_there() -> None:
    mask = torch.zeros(5, 1, 8, 8)
    mask[:4, :, 2:6, 2:6] = 1
    images = torch.full((5, 3, 8, 8), 7.0)  # what is not face does not count
    for k, level in enumerate((0.02, 0.2, 0.8, 0.0)):
        images[k, :, 2:6, 2:6] = level
    expected = [USUAL[0] / 0.02, 1.0, USUAL[1] / 0.8, 1.0, 1.0]
    torch.testing.assert_close(metering_gain(images, mask).flatten(), torch.tensor(expected))


class Grey(Network):
    """Answers a frontal plane whose shading is the mean of its image, and keeps what it was given."""

    architecture, multiple = "grey", 1
    seen: Tensor

    def __init__(self) -> None:
        super().__init__({})

    def forward(self, image: Tensor) -> NetworkOutput:
        """See ``Network``."""
        self.seen = image
        normal = torch.zeros_like(image)
        normal[:, 2] = 1
        light = torch.zeros(len(image), 27)
        light[:, ::9] = image.mean((2, 3)) / 0.282095  # Y00
        return NetworkOutput(normal, torch.ones_like(image), light)


@pytest.mark.parametrize("level", [0.01, 0.3, 0.9])
def test_the_reconstruction_has_the_exposure_of_the_picture(level: float) -> None:
    picture = Photograph("p", np.full((128, 128, 3), level, np.float32), np.ones((128, 128), np.float32))
    network = Grey()
    [face] = run_network(network, [picture])
    assert USUAL[0] - 1e-6 <= float(network.seen.mean()) <= USUAL[1] + 1e-6
    # Rounding of float32, eight numbers in a row.
    np.testing.assert_allclose(face.reconstruction, level, rtol=1e-5)
    np.testing.assert_allclose(face.shading, level, rtol=1e-5)
