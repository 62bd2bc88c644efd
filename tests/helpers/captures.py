"""Captures whose labels are exact, in files and out of them."""

from __future__ import annotations

from pathlib import Path

import torch

from sfsnet_dr.data.normal_labels import NormalLabels, light_labels, write_index, write_normal_labels
from sfsnet_dr.render.shading_torch import f_render

SUBJECTS = tuple(f"a{number}" for number in range(1, 7))
SIZE = 16


def face(subject: str, size: int = SIZE) -> NormalLabels:
    """A grey bent surface whose pictures are what its labels render, order-2 light and all."""
    generator = torch.Generator().manual_seed(SUBJECTS.index(subject))
    normal = 0.3 * torch.randn(3, size, size, generator=generator)
    normal[2] = 1
    normal = normal / normal.norm(dim=0)
    albedo = 0.2 + 0.2 * torch.rand(1, size, size, generator=generator)
    direction = torch.tensor([[0.0, 0.0, 1.0], [0.5, 0.0, 0.8], [-0.4, 0.3, 0.8], [0.1, -0.5, 0.8]])
    direction = direction / direction.norm(dim=1, keepdim=True)
    gain = torch.tensor([1.0, 0.5, 1.2, 0.8])
    light = torch.from_numpy(light_labels(direction.numpy(), gain.numpy())).float()
    image = f_render(normal.expand(4, -1, -1, -1), albedo.expand(4, 3, -1, -1), light)[:, :1]
    mask = torch.ones(1, size, size)
    mask[:, :2] = 0
    return NormalLabels(
        name=subject, subject=subject, lights=tuple("abcd"), files=tuple("abcd"), image=image,
        normal=normal, albedo=albedo, mask=mask, confidence=0.5 + 0.5 * mask, residual=0 * mask,
        direction=direction, gain=gain,
    )  # fmt: skip


def write_faces(
    folder: Path, subjects: tuple[str, ...] = SUBJECTS, size: int = SIZE, lamps_by: str = ""
) -> Path:
    folder.mkdir(parents=True)
    rows = {
        name: {"subject": name, "sha256": write_normal_labels(folder, face(name, size))} for name in subjects
    }
    write_index(folder, "balls", {"oblique": 0.0, "strength": {}, "calibrated_by": lamps_by}, rows, {})
    return folder
