"""Every kind of light has a sampler and a weight."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from sfsnet_dr.scene.lights import sampling
from sfsnet_dr.scene.lights.light import Light
from sfsnet_dr.scene.lights.sampling import LIGHT_SAMPLERS, sample_scene_light
from sfsnet_dr.scene.lights.spec import LIGHT_KINDS, LightKind, LightSpec


def test_every_kind_has_a_sampler_and_a_weight() -> None:
    assert set(LIGHT_SAMPLERS) == set(LIGHT_KINDS)
    assert set(LIGHT_KINDS) <= {field.name for field in fields(LightSpec)}


@pytest.mark.parametrize("kind", [kind for kind in LIGHT_KINDS if kind != "hdr"])
def test_a_weight_alone_draws_its_kind(kind: LightKind, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[str] = []

    def sample(rng: np.random.Generator, spec: LightSpec, directions: object) -> Light:
        drawn.append(kind)
        return Light.from_environment(1.0)

    monkeypatch.setitem(sampling.LIGHT_SAMPLERS, kind, sample)
    none = replace(LightSpec(), hdr=0, sun_sky=0, studio=0, directional=0, ambient=0, lobes=0, fitted=0)
    sample_scene_light(np.random.default_rng(0), replace(none, **{kind: 1.0}))  # type: ignore[arg-type]
    assert drawn == [kind]
