"""A face model of ellipsoid, nose and smooth modes, with 68 landmarks: small, known, and nobody's."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sfsnet_dr.scene.faces.linear_model import FaceModes, outline_strips

Array = npt.NDArray[np.float64]

IDENTITIES, UNITS = 6, 2
_SIDE = 49


def fake_model(seed: int = 0) -> FaceModes:
    """2,401 vertices; six identities of about a millimetre and two units."""
    grid = np.linspace(-1.05, 1.05, _SIDE)
    u, v = np.meshgrid(grid, grid[::-1])
    azimuth, height = 1.25 * u.ravel(), 1.2 * v.ravel()
    mean = np.stack(
        [
            0.72 * np.cos(height) * np.sin(azimuth),
            1.0 * np.sin(height),
            0.9 * np.cos(height) * np.cos(azimuth),
        ],
        -1,
    )
    nose = np.exp(-((mean[:, 0] / 0.12) ** 2) - ((mean[:, 1] + 0.05) / 0.22) ** 2)
    mean[:, 2] += 0.28 * nose
    rng = np.random.default_rng(seed)
    waves = rng.uniform(1.0, 3.0, (IDENTITIES + UNITS, 3, 3))
    phases = rng.uniform(0, 2 * np.pi, (IDENTITIES + UNITS, 3))
    modes = 0.02 * np.sin(np.einsum("vc,mac->mva", mean, waves) + phases[:, None])
    number = np.arange(_SIDE * _SIDE).reshape(_SIDE, _SIDE)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    places = landmark_places()
    vertices = ((mean[None, :, :2] - places[:, None]) ** 2).sum(-1).argmin(axis=1)
    skin = np.ones(len(mean))
    return FaceModes(
        digest="fake",
        mean=mean,
        modes=modes.astype(np.float32),
        identities=IDENTITIES,
        faces=faces.astype(np.uint32),
        skin=skin,
        bare=skin,
        inner=vertices[17:],
        outline=outline_strips(mean, vertices[:17], vertices[17:]),
    )


def landmark_places() -> Array:
    """(68, 2) decimetres: jaw, brows, nose, eyes 0.62 apart, mouth."""
    places = np.zeros((68, 2))
    jaw = np.linspace(np.pi, 2 * np.pi, 17)
    places[:17] = np.stack([0.62 * np.cos(jaw), 0.2 + 0.95 * np.sin(jaw)], -1)
    brow = np.linspace(-0.46, -0.12, 5)
    places[17:22], places[22:27] = (
        np.stack([brow, 0.42 + 0 * brow], -1),
        np.stack([-brow[::-1], 0.42 + 0 * brow], -1),
    )
    places[27:31] = np.stack([np.zeros(4), np.linspace(0.25, -0.05, 4)], -1)
    places[31:36] = np.stack([np.linspace(-0.12, 0.12, 5), np.full(5, -0.14)], -1)
    turn = np.pi - 2 * np.pi * np.arange(6) / 6
    for begin, x in ((36, -0.31), (42, 0.31)):
        places[begin : begin + 6] = np.stack([x + 0.1 * np.cos(turn), 0.28 + 0.04 * np.sin(turn)], -1)
    turn = np.pi - 2 * np.pi * np.arange(12) / 12
    places[48:60] = np.stack([0.2 * np.cos(turn), -0.38 + 0.08 * np.sin(turn)], -1)
    turn = np.pi - 2 * np.pi * np.arange(8) / 8
    places[60:] = np.stack([0.14 * np.cos(turn), -0.38 + 0.04 * np.sin(turn)], -1)
    return places
