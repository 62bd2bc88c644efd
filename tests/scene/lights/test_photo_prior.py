"""Mixtures of lights: learnt, kept, drawn from, and made into lights that can exist."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from sfsnet_dr.core.color import LUMINANCE
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.estimation.light_prior import fit_mixture
from sfsnet_dr.scene.lights.cache import draw_lights, light_fingerprint
from sfsnet_dr.scene.lights.light import face_normals
from sfsnet_dr.scene.lights.photo_prior import (
    LightMixture,
    draw_photo_light,
    lights_visibly,
    possible_light,
    read_mixture,
    write_mixture,
)
from sfsnet_dr.scene.lights.spec import LightSpec
from sfsnet_dr.scene.lights.vmf_lobes import sample_lights

Array = npt.NDArray[np.float64]

FITTED_ONLY = LightSpec(hdr=0, sun_sky=0, studio=0, directional=0, ambient=0, fitted=1)


def mixture() -> LightMixture:
    """Two components around lights of the closed-form prior."""
    rng = np.random.default_rng(0)
    lights = sample_lights(rng, 2)
    means = np.array([light.coefficients(2).to_shading().flat() for light in lights])
    factors = np.array([np.tril(rng.normal(0, 0.03, (27, 27))) + 0.05 * np.eye(27) for _ in lights])
    return LightMixture(np.array([0.3, 0.7]), means, factors, {"photographs": 0})


def test_draws_have_the_moments_of_the_mixture() -> None:
    count = 30_000
    drawn = mixture().draw(np.random.default_rng(1), count)
    mean, covariance = mixture().moments()
    deviation = np.sqrt(np.diag(covariance))
    # Standard errors: sigma / sqrt(N) of a mean, below 1.5 sigma^2 / sqrt(N) of a covariance; times 5.
    assert (np.abs(drawn.mean(0) - mean) / deviation).max() < 5 / np.sqrt(count)
    off = np.abs(np.cov(drawn.T) - covariance) / np.outer(deviation, deviation)
    assert off.max() < 7.5 / np.sqrt(count)


def test_samples_shade_no_visible_normal_negatively_and_repeat() -> None:
    kept = [mixture().sample(rng) for rng in [np.random.default_rng(2)] for _ in range(50)]
    assert lights_visibly(np.array(kept)).all()
    again = mixture().sample(np.random.default_rng(2))
    np.testing.assert_array_equal(kept[0], again)
    dark = LightMixture(np.ones(1), -np.ones((1, 27)), 1e-3 * np.eye(27)[None], {})
    with pytest.raises(InputError, match="none of 1000 lights"):
        dark.sample(np.random.default_rng(0))


def test_a_kept_mixture_is_the_same_to_five_digits(tmp_path: Path) -> None:
    write_mixture(tmp_path / "m.json", mixture())
    found = read_mixture(tmp_path / "m.json")
    for name in ("shares", "means", "factors"):
        np.testing.assert_allclose(getattr(found, name), getattr(mixture(), name), rtol=5e-5, atol=1e-12)
    assert found.source == {"photographs": 0}
    write_mixture(tmp_path / "n.json", found)
    assert (tmp_path / "m.json").read_bytes() == (tmp_path / "n.json").read_bytes()


def cut(text: str) -> str:
    return text[: len(text) // 2]


def other_format(text: str) -> str:
    return text.replace("light_mixture.1", "light_mixture.9")


def poisoned(text: str) -> str:
    plain = json.loads(text)
    plain["means"][0][0] = float("nan")
    return json.dumps(plain)


def few(text: str) -> str:
    plain = json.loads(text)
    plain["means"][0] = plain["means"][0][:9]
    return json.dumps(plain)


@pytest.mark.parametrize("spoil", [cut, other_format, poisoned, few], ids=lambda f: f.__name__)
def test_a_damaged_mixture_is_named(spoil: Callable[[str], str], tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    write_mixture(path, mixture())
    path.write_text(spoil(path.read_text()))
    with pytest.raises(InputError, match=r"m\.json: no mixture of lights") as error:
        read_mixture(path)
    assert "\n" not in str(error.value)
    with pytest.raises(InputError, match="no such file"):
        read_mixture(tmp_path / "absent.json")


def test_expectation_and_maximisation_find_a_known_mixture() -> None:
    rng = np.random.default_rng(0)
    means = np.array([[0.0, 0.0, 0.0], [4.0, -3.0, 1.0]])
    roots = np.array([np.diag([1.0, 0.5, 0.2]), [[0.3, 0, 0], [0.4, 0.6, 0], [0.1, -0.2, 0.5]]])
    label = rng.random(20_000) < 0.25
    rows = means[label.astype(int)] + np.einsum(
        "nij,nj->ni", roots[label.astype(int)], rng.normal(size=(20_000, 3))
    )
    found = fit_mixture(rows, 2, seed=1, floor=1e-9)
    order = np.argsort(found.means[:, 0])
    np.testing.assert_allclose(found.shares[order], [0.75, 0.25], atol=0.01)
    np.testing.assert_allclose(found.means[order], means, atol=0.05)
    covariances = np.einsum("kij,klj->kil", found.factors, found.factors)[order]
    np.testing.assert_allclose(covariances, np.einsum("kij,klj->kil", roots, roots), atol=0.04)
    assert (np.diff(found.likelihood) > -1e-9).all()
    alone = fit_mixture(rows, 1, floor=0.0)
    np.testing.assert_allclose(alone.means[0], rows.mean(0), atol=1e-9)
    np.testing.assert_allclose(alone.factors[0] @ alone.factors[0].T, np.cov(rows.T, bias=True), atol=1e-9)
    with pytest.raises(InputError, match="5 finite rows found, more than 6"):
        fit_mixture(rows[:5], 2)


def test_a_light_that_exists_stays_and_others_move_little() -> None:
    for light in sample_lights(np.random.default_rng(4), 5):
        wanted = light.coefficients(2).to_shading()
        found = possible_light(wanted.flat())
        assert found.environment is not None
        assert found.environment.min() >= 0
        shading = [each.evaluate(face_normals()) for each in (found.shading_label(), wanted)]
        assert np.abs(shading[0] - shading[1]).max() < 0.02 * shading[1].max()  # 0.01 seen


def test_the_package_has_a_mixture_of_many_photographs() -> None:
    own = read_mixture()
    assert own.source["photographs"] >= 3000
    drawn = own.draw(np.random.default_rng(0), 2000)
    level = (drawn.reshape(-1, 3, 9) @ np.asarray(own_levels())) @ LUMINANCE
    assert np.median(level) == pytest.approx(1.0, abs=0.05)
    # Photographs are lit from above and from the front on average.
    mean = own.moments()[0].reshape(3, 9)
    assert (mean[:, 3] > 0.1).all()
    assert (mean[:, 1] > 0.1).all()


def own_levels() -> Array:
    from sfsnet_dr.sh.basis import sh_basis

    return np.asarray(sh_basis(face_normals(), 2).mean(axis=0))


def test_banks_draw_fitted_lights(tmp_path: Path) -> None:
    bank = draw_lights(FITTED_ONLY, 3, seed=0)
    again = draw_lights(FITTED_ONLY, 3, seed=0)
    np.testing.assert_array_equal(bank.radiance, again.radiance)
    assert not bank.power.any()
    assert not bank.free.any()
    assert len({row.tobytes() for row in bank.radiance}) == 3
    path = tmp_path / "mine.json"
    write_mixture(path, mixture())
    assert draw_photo_light(np.random.default_rng(0), str(path)).environment is not None
    fingerprints = {
        light_fingerprint(FITTED_ONLY, 3, 0),
        light_fingerprint(LightSpec(fitted=1, light_prior_file=str(path)), 3, 0),
        light_fingerprint(LightSpec(), 3, 0),
    }
    assert len(fingerprints) == 3
