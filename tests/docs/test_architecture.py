"""The worked examples of the architecture page: a network and a renderer of one's own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import sfsnet_dr as sf
from sfsnet_dr.models import weights
from sfsnet_dr.render.renderers.base import Budget


def test_a_network_of_ones_own_is_built_saved_and_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # docs: network
    from torch import Tensor, nn

    from sfsnet_dr.models.base import Network, NetworkOutput

    class TinyNet(Network):
        """One convolution for each map."""

        architecture = "tiny"
        multiple = 1

        def __init__(self, width: int = 4) -> None:
            super().__init__({"width": width})
            self.maps = nn.Sequential(nn.Conv2d(3, width, 3, padding=1), nn.ReLU(), nn.Conv2d(width, 6, 1))
            self.light = nn.Linear(3, 27)

        def forward(self, image: Tensor) -> NetworkOutput:
            self.check(image)
            maps = self.maps(image)
            normal = nn.functional.normalize(maps[:, :3], dim=1)
            return NetworkOutput(normal, maps[:, 3:], self.light(image.mean((2, 3))))

    # docs: end network
    monkeypatch.setitem(weights.ARCHITECTURES, "tiny", TinyNet)
    network = weights.build_network("tiny", {"width": 3})
    weights.save_weights(tmp_path / "tiny.safetensors", network)
    loaded = sf.load_model(tmp_path / "tiny.safetensors")
    image = torch.rand(1, 3, 128, 128)
    for ours, again in zip(network.eval()(image), loaded.model(image), strict=True):
        torch.testing.assert_close(ours, again)


def test_a_renderer_of_ones_own_is_asked_like_ours() -> None:
    # docs: renderer
    from sfsnet_dr.render.renderers.base import Capabilities, Image
    from sfsnet_dr.render.renderers.sh import surface_maps
    from sfsnet_dr.scene.lights.light import Light
    from sfsnet_dr.scene.subject import Subject

    class FlatRenderer:
        """Albedo under the mean light: order 0."""

        name = "flat"
        capabilities = Capabilities(visibility=False, order=0)

        def render(self, subject: Subject, light: Light, budget: Budget) -> Image:
            albedo = np.moveaxis(surface_maps(subject).albedo[0], 0, -1)
            shading = light.coefficients(0).to_shading().evaluate([0.0, 0.0, 1.0])
            return np.asarray(albedo * shading)

    # docs: end renderer
    subject, light = sf.build_subject("sphere"), sf.sample_light(0, "ambient")
    expected = sf.find_renderer("numpy-order0").render(subject, light, Budget())
    np.testing.assert_allclose(FlatRenderer().render(subject, light, Budget()), expected, atol=1e-6)
