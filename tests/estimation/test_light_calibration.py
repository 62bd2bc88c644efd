"""Lamps found from pictures and a first guess at the faces, against lamps that are known."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch
from helpers.look_alikes import ANGLES, crop_normals, write_yale_b
from torch import Tensor

from sfsnet_dr.cli.main import main
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.databases.base import heading
from sfsnet_dr.data.databases.yale_b import list_yale_b
from sfsnet_dr.data.normal_dataset import NormalLabelOptions, load_training_subjects, read_split
from sfsnet_dr.data.normal_labels import light_labels, load_normal_labels, read_index
from sfsnet_dr.estimation.light_calibration import CalibratedLights, InitialNormals, calibrate_lights
from sfsnet_dr.experiments.photometric_stereo import uncalibrated
from sfsnet_dr.experiments.photometric_stereo.captures import read_image_sets
from sfsnet_dr.experiments.photometric_stereo.uncalibrated import calibrate_image_sets, light_direction_errors
from sfsnet_dr.inference.methods import Prediction
from sfsnet_dr.metrics.normals import angles_deg
from sfsnet_dr.models.sfsnet import SfSNet
from sfsnet_dr.models.weights import save_weights

Array = npt.NDArray[np.float64]

LAMPS = np.array([heading(a, e) for e in (-35, -10, 15, 40) for a in (-75, -45, -20, 0, 20, 45, 75)])
NAMES = tuple(f"lamp {number:02d}" for number in range(len(LAMPS)))


def face(seed: int, count: int = 400) -> tuple[Array, Array]:
    """Normals (P, 3) of a wide bump, and albedo (P, 1)."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-0.75, 0.75, (2, count))
    normal = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0.05))], 1)
    unit = np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))
    return unit, rng.uniform(0.2, 0.6, (count, 1))


def pitched(vectors: Array, degrees: float) -> Array:
    """Turned about x."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.asarray(vectors @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]).T)


def guess(
    seed: int, pitch: float = 0.0, gain: float = 1.0, lamps: Array = LAMPS, wrong: Array | None = None
) -> InitialNormals:
    """A capture whose network takes everything to be pitched; ``wrong`` replaces its directions."""
    normal, albedo = face(seed)
    values = gain * albedo * np.maximum(normal @ lamps.T, 0)
    seen = pitched(lamps, pitch) if wrong is None else wrong
    return InitialNormals(values, NAMES[: len(lamps)], pitched(normal, pitch), seen)


def errors(captures: Sequence[InitialNormals]) -> Array:
    found = calibrate_lights(captures)
    return np.array([angles_deg(found.direction[name], LAMPS[NAMES.index(name)]) for name in found.direction])


def test_a_right_guess_finds_the_lamps() -> None:
    # The first guess of the albedo, a quantile, is not quite linear in the truth: 0.6 on average, 1.0 at
    # most.
    assert errors([guess(0)]).max() < 1.5


def test_smooth_errors_of_the_guess_are_corrected_by_the_pictures() -> None:
    """Of a network that bends faces, which no linear map undoes: the pictures tell that it is wrong."""
    right = guess(1)
    x, y, z = right.normal.T
    bent = np.stack([x - 0.3 * x * y, y + 0.3 * x * x, z], 1)
    bent /= np.linalg.norm(bent, axis=1, keepdims=True)
    assert angles_deg(bent, right.normal).mean() > 4
    found = errors([InitialNormals(right.values, right.lamps, bent, LAMPS)])
    assert found.mean() < 2.2  # 1.5 measured


def test_pitch_that_differs_between_captures_cancels() -> None:
    """One capture alone keeps what its network gets wrong; several do not."""
    alone = errors([guess(0, 12.0)])
    assert 8 < alone.mean() < 14
    several = errors([guess(seed, pitch) for seed, pitch in enumerate((12.0, -12.0, 4.0, -4.0, 0.0))])
    assert several.mean() < 1.0  # 0.7 measured, what a right guess leaves


def test_captures_are_turned_to_where_heads_usually_face() -> None:
    """All networks' answers pitch one way; what heads look like on average tells."""
    pitched_all = [guess(seed, 10.0) for seed in range(4)]
    assert errors(pitched_all).mean() > 8
    means = [0.8 * face(seed)[0] for seed in range(4)]
    assert errors([replace(a, usual=b) for a, b in zip(pitched_all, means, strict=True)]).mean() < 1.0
    half = np.arange(400)[:, None] < 200  # pixels of which nothing is known have no say
    blind = [replace(a, usual=np.where(half, b, 0.0)) for a, b in zip(pitched_all, means, strict=True)]
    assert errors(blind).mean() < 1.5
    wrong = [replace(part, usual=pitched(face(seed)[0], 5.0)) for seed, part in enumerate(pitched_all)]
    assert 4 < errors(wrong).mean() < 6


def test_lamps_of_stretched_surfaces_explain_the_same_pictures() -> None:
    normal, albedo = face(3)
    lamps = CalibratedLights(dict(zip(NAMES, LAMPS, strict=True)), {}, dict.fromkeys(NAMES, 2.0))
    stretched = lamps.for_stretched(0.9, 1.2)
    for name, vector in zip(NAMES, LAMPS, strict=True):
        before = 2.0 * (albedo * normal) @ vector
        after = (albedo * normal * [0.9, 1.2, 1]) @ (stretched.strength[name] * stretched.direction[name])
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-12)


def test_dark_skin_is_no_weak_lamp() -> None:
    several = errors([guess(seed, gain=gain) for seed, gain in enumerate((1.0, 0.4, 1.3))])
    assert several.max() < 1.6  # 1.1 measured


def test_a_lamp_that_lights_nothing_is_told_and_left_out() -> None:
    lamps = LAMPS.copy()
    lamps[3] = [0.0, 0.3, -0.95]
    found = calibrate_lights([guess(0, lamps=lamps / np.linalg.norm(lamps, axis=1, keepdims=True))])
    assert set(found.lost) == {NAMES[3]}
    assert NAMES[3] not in found.direction
    away = LAMPS.copy()
    away[0] = [0.0, 0.0, 1.0]  # the network sees it in front, the pictures at its side
    found = calibrate_lights([guess(0, wrong=away)])
    assert "degrees from where the network sees it" in found.lost[NAMES[0]]


def test_too_few_lamps_are_refused() -> None:
    with pytest.raises(InputError, match="11 lamps at most found, 12 in one capture are needed"):
        calibrate_lights([guess(0, lamps=LAMPS[:11])])


class Oracle:
    """In place of a network: the look-alikes' normals, and lights that it reads off the brightest side."""

    def __init__(self, name: str, weights: Path | str) -> None:
        self.name = name

    def __call__(self, images: Tensor, masks: Tensor, subjects: Sequence[str]) -> Prediction:
        """See ``Method``."""
        normal = torch.from_numpy(np.moveaxis(crop_normals(), -1, 0)).float()
        bright = (images * normal * masks).flatten(2).sum(2)
        light = light_labels(bright.double().numpy(), np.ones(len(images)))
        return Prediction(normal.expand_as(images), images, torch.from_numpy(light).float(), images)


@pytest.fixture
def oracle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uncalibrated, "NetworkMethod", Oracle)


def test_a_database_is_told_where_its_lamps_were(tmp_path: Path, oracle: None) -> None:
    known = list_yale_b(write_yale_b(tmp_path / "yale", 2))
    found = calibrate_image_sets(read_image_sets(known), "skipnet").listing
    assert found.calibrated_by == "skipnet"
    told = light_direction_errors(known, found)
    assert len(told) == len(ANGLES)
    assert max(told.values()) < 1.0  # 8 bits, and a frame interpolated from another
    assert light_direction_errors(known, known) == dict.fromkeys(told, 0.0)


def test_labels_without_known_lamps_are_nearly_those_with(
    tmp_path: Path, oracle: None, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_yale_b(tmp_path / "yale", 2)
    for out, more in (("known", []), ("found", ["--calibrate-with", "skipnet"])):
        assert main(["photometric-stereo", str(folder), "--out", str(tmp_path / out), *more, "--json"]) == 0
        records = {record["what"]: record["value"] for record in json.loads(capsys.readouterr().out)}
        assert ("stereo.yale_b.lamps_found_deg" in records) == bool(more)
    assert records["stereo.yale_b.lamps_found"] == len(ANGLES)
    assert records["stereo.yale_b.lamps_found_deg"] < 1.0
    assert read_index(tmp_path / "known")["calibrated_by"] == ""
    assert read_index(tmp_path / "found")["calibrated_by"] == "skipnet"
    for one, other in zip(
        load_normal_labels(tmp_path / "known"), load_normal_labels(tmp_path / "found"), strict=True
    ):
        mask = (one.mask[0] > 0.5).numpy()
        a, b = (part.normal.permute(1, 2, 0).double().numpy()[mask] for part in (one, other))
        assert angles_deg(a, b).mean() < 1.0
    _, split = load_training_subjects(tmp_path / "found", NormalLabelOptions(batch_fraction=0.5, folds=2))
    assert split.calibrated_by == "skipnet"
    assert read_split({"normal_labels": split.metadata}) == split


def test_how_steep_faces_are_is_told_by_heads(
    tmp_path: Path, oracle: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A network that sees all faces too flat sees the lamps too oblique; heads on average are not flat."""
    read = read_image_sets(list_yale_b(write_yale_b(tmp_path / "yale", 2)))
    known = torch.from_numpy(np.moveaxis(crop_normals(), -1, 0)).float()
    head = (crop_normals(), np.ones(crop_normals().shape[:2], bool))
    flat = (known / torch.tensor([1.2, 1.2, 1.0])[:, None, None]).numpy()
    monkeypatch.setattr(sys.modules[__name__], "crop_normals", lambda: np.moveaxis(flat, 0, -1))
    monkeypatch.setattr(uncalibrated, "mean_normals", lambda heads: 0.9 * known)
    monkeypatch.setattr(uncalibrated, "head_normals", lambda heads, most: [head] * most)
    told = [
        np.mean(
            list(
                light_direction_errors(
                    read.listing, calibrate_image_sets(read, "skipnet", heads).listing
                ).values()
            )
        )
        for heads in ((), ("heads",))
    ]
    assert told[0] > 3
    assert told[1] < 1.0, told


def test_heads_tell_what_the_measure_of_a_stretch_makes_of_surfaces(
    tmp_path: Path, oracle: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where that measure finds heads 5 % too steep down a face, it is to find as much of people."""
    read = read_image_sets(list_yale_b(write_yale_b(tmp_path / "yale", 2)))
    normals = crop_normals()
    usual = torch.from_numpy(np.moveaxis(normals, -1, 0)).float()
    monkeypatch.setattr(uncalibrated, "mean_normals", lambda heads: usual)
    monkeypatch.setattr(uncalibrated, "resolve_bas_relief_scale", lambda faces, heads: 1.0)
    slopes = []
    for factor in (1.0, 1.05):
        head = (normals * np.array([1, factor, 1]), np.ones(normals.shape[:2], bool))
        monkeypatch.setattr(uncalibrated, "head_normals", lambda heads, most, head=head: [head] * most)
        listing = calibrate_image_sets(read, "skipnet", ("heads",)).listing
        slopes.append([p.direction[1] / p.direction[2] for p in listing.photos if p.direction is not None])
    # Steeper faces and lamps nearer to the horizontal explain the same pictures.
    np.testing.assert_allclose(np.array(slopes[1]) * 1.05, slopes[0], atol=0.01)  # 0.002 by the search's end


def test_a_network_is_asked(tmp_path: Path) -> None:
    """Any network answers something; a random one is no help, which the numbers show."""
    torch.manual_seed(0)
    save_weights(tmp_path / "w.safetensors", SfSNet(4, 4, 1), {"recipe": {"data": {"size": 32}}})
    known = list_yale_b(write_yale_b(tmp_path / "yale", 1))
    found = calibrate_image_sets(read_image_sets(known), tmp_path / "w.safetensors").listing
    assert found.calibrated_by == "w"
    told = light_direction_errors(known, found)
    assert not told or np.mean(list(told.values())) > 5
