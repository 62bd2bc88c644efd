"""Real faces of several sources in one mini-batch, and what their light counts for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from data.test_mixed_batch import write_labels
from data.test_normal_dataset import RECIPE
from helpers.captures import SIZE, face

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.mixed_batch import ConcatSource, MixedBatch, PseudoLabelOptions, RealFaces
from sfsnet_dr.data.normal_dataset import NormalLabelFaces, NormalLabelOptions
from sfsnet_dr.data.pseudo_labels import load_pseudo_labels
from sfsnet_dr.losses.sfsnet import LossWeights, light_confidence, mixed_loss
from sfsnet_dr.models.base import NetworkOutput
from sfsnet_dr.train.sources import configure_sources
from sfsnet_dr.train.trainer import train


def test_a_lamp_behind_a_face_does_not_outweigh_the_others() -> None:
    """Its picture is 500 times darker; an error of a tenth of each light then costs a hundredth at most."""
    options, labels = NormalLabelOptions(exposure=0.0, flip=0.0), face("a2")
    dark = replace(labels, image=labels.image * torch.tensor([1, 1, 1, 0.002])[:, None, None, None])
    real = NormalLabelFaces([dark], 4, options, seed=0).batch(0)
    strength = real.faces.light.square().mean(1)
    assert strength.max() > 1e4 * strength.min()
    trust = light_confidence(real.faces.light, real)
    torch.testing.assert_close(trust, 1 / strength.clamp_min(1))
    told = real._replace(free_scale=torch.zeros(4, dtype=torch.bool))
    assert torch.equal(light_confidence(real.faces.light, told), told.light_trust)
    answer = NetworkOutput(real.faces.normal, real.faces.albedo, 0.9 * real.faces.light)
    labelled = real.faces._replace(light=answer.light)
    both = NetworkOutput(*(torch.cat([part, part]) for part in answer))
    _, _, terms = mixed_loss(both, MixedBatch(labelled, real), LossWeights(), LossWeights(), "torch")
    assert 0.01 / 4 < float(terms.light) <= 0.01 * 1.0001


def test_photographs_and_captures_are_learnt_from_together(
    surfaces: Path, spheres: Path, tmp_path: Path
) -> None:
    labels = write_labels(tmp_path / "labels", size=SIZE)
    recipe = replace(
        RECIPE,
        real=PseudoLabelOptions(batch_fraction=0.25),
        normal_labels=replace(RECIPE.normal_labels, batch_fraction=0.25),
        steps=2,
    )
    part = configure_sources(recipe, labels, surfaces, None)
    assert part.counts == (1, 1)
    real = part.open(torch.device("cpu"))
    photograph, capture = (source.open(torch.device("cpu")) for source in part.sources)
    batch = real.batch(3)
    assert batch.free_scale.tolist() == [False, True]
    for whole, *pieces in zip(
        (*batch.faces, *batch[1:]),
        *((*alone.faces, *alone[1:]) for alone in (photograph.batch(3), capture.batch(3))),
        strict=True,
    ):
        assert torch.equal(torch.cat(pieces), whole)
    assert real.names(3) == photograph.names(3) + capture.names(3)
    assert real.fingerprint not in (photograph.fingerprint, capture.fingerprint)
    run = train(recipe, spheres, tmp_path / "run", labels=labels, surfaces=surfaces, progress=False)
    assert {"real_normal", "real_light"} <= set(run.final)
    small = RealFaces(
        load_pseudo_labels(write_labels(tmp_path / "small", size=8)), 1, PseudoLabelOptions(), 0
    )
    with pytest.raises(InputError, match=r"images of \[\(8, 8\), \(16, 16\)\] pixels found"):
        ConcatSource([small, capture])
