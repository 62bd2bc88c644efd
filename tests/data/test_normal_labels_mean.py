"""How heads face on average, against spheres that all face one way."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from helpers.spheres import write_spheres

from sfsnet_dr.cli.main import main
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.bundle import read_bundle
from sfsnet_dr.data.normal_labels import head_normals, mean_normals
from sfsnet_dr.data.transforms.crop import Crop
from sfsnet_dr.data.transforms.mirror import mirror_normal


def test_the_mean_of_one_head_is_that_head_and_its_mirror_image(tmp_path: Path) -> None:
    folder = write_spheres(tmp_path / "one", 1)
    bundle = read_bundle(next(folder.glob("*.exr")))
    found = mean_normals(folder)
    assert found.shape == (3, 128, 128)
    torch.testing.assert_close(mirror_normal(found), found)
    skin = torch.from_numpy(bundle.mask)[None].float()
    shown = Crop(skin.shape[-1]).invert(torch.from_numpy(bundle.normal).movedim(-1, 0).float() * skin, 128)
    inside = found.abs().sum(0) > 0
    assert 0.1 < inside.float().mean() < 1
    assert not inside[0, 0]
    cover = Crop(skin.shape[-1]).invert(skin, 128)[0]
    whole = torch.minimum(cover, cover.flip(-1)) > 0.999
    expected = (shown + mirror_normal(shown)) / 2
    torch.testing.assert_close(found[:, whole], expected[:, whole], rtol=0, atol=1e-3)
    both = mean_normals([folder, write_spheres(tmp_path / "more", 3)])
    assert not torch.equal(both, found)


def test_single_heads_are_those_of_the_mean(tmp_path: Path) -> None:
    folder = write_spheres(tmp_path / "three", 3)
    heads = list(head_normals(folder, 10))
    assert len(heads) == 3
    assert len(list(head_normals(folder, 2))) == 2
    normal, known = (torch.from_numpy(part) for part in heads[0])
    assert normal.shape == (128, 128, 3)
    assert 0.1 < known.double().mean() < 1
    torch.testing.assert_close(normal[known].norm(dim=1).median().item(), 1.0, rtol=0, atol=0.01)
    one = mean_normals(write_spheres(tmp_path / "one", 1)).movedim(0, -1)
    both = known & known.flip(-1)
    mirrored = (normal + mirror_normal(normal.movedim(-1, 0)).movedim(0, -1)) / 2
    torch.testing.assert_close(
        one[both].double(), mirrored[both], rtol=0, atol=0.01
    )  # pixels 0.99 skin count


def test_bad_heads_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match="no bundles"):
        mean_normals(tmp_path)
    assert main(["photometric-stereo", str(tmp_path), "--out", "o", "--prior-faces", str(tmp_path)]) == 2
    assert "--prior-faces: found without --calibrate-with" in capsys.readouterr().err
