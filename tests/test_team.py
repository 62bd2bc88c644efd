"""Two processes train as one does."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from spheres import write_spheres
from test_mixture import RECIPE, write_labels

from sfsnet_dr.base.checks import BadInput
from sfsnet_dr.data.augment import Augmentation
from sfsnet_dr.data.batch import dealt
from sfsnet_dr.data.dataset import RelitFaces, load_faces
from sfsnet_dr.data.mixture import MixedFaces, RealFaces
from sfsnet_dr.data.photo_effects import PhotoOptions
from sfsnet_dr.data.pseudo_labels import load_pseudo_labels
from sfsnet_dr.fit.history import read_history
from sfsnet_dr.fit.run import HISTORY, WEIGHTS
from sfsnet_dr.fit.team import join
from sfsnet_dr.fit.trainer import train
from sfsnet_dr.model.predict import predict
from sfsnet_dr.model.weights import load_weights

SCRIPT = """
import sys
sys.path.insert(0, sys.argv[1])
import torch
torch.set_num_threads(1)
from test_mixture import RECIPE
from sfsnet_dr.fit.trainer import train
train(RECIPE, sys.argv[2], sys.argv[3], labels=sys.argv[4], progress=False)
"""


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port: int = found.getsockname()[1]
        return port


def together(count: int, *arguments: Path) -> None:
    """Run the script in several processes as torchrun would."""
    place = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(free_port()), "WORLD_SIZE": str(count)}
    command = [sys.executable, "-c", SCRIPT, str(Path(__file__).parent), *map(str, arguments)]
    processes = [
        subprocess.Popen(
            command,
            env=os.environ | place | {"RANK": str(rank), "LOCAL_RANK": str(rank)},
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank in range(count)
    ]
    for process in processes:
        _, told = process.communicate(timeout=120)
        assert process.returncode == 0, told


def test_two_processes_give_the_result_of_one(tmp_path: Path) -> None:
    """Rendered and real faces, masks of different sizes in both halves, batch normalisation over both.

    In exact arithmetic both are the same. In single precision losses differ by 5e-7 of themselves at first;
    Adam divides by the gradient's size, so that rounding grows with the steps: measured are LOSS and ANSWER
    over 4, for losses and answers after all six.
    """
    faces, labels = write_spheres(tmp_path / "faces", 3), write_labels(tmp_path / "labels")
    train(RECIPE, faces, tmp_path / "one", labels=labels, progress=False)
    together(2, faces, tmp_path / "two", labels)
    one, two = (read_history(tmp_path / name / HISTORY) for name in ("one", "two"))
    assert [line["step"] for line in two] == list(range(RECIPE.steps))
    terms = [name for name in one[0] if name not in ("step", "rate", "images_per_second")]
    for name in terms:
        rel = 0.2 if name.endswith("_spread") else 3e-6  # means of two ratios are not the ratio of means
        assert two[0][name] == pytest.approx(one[0][name], rel=rel), name
    for a, b in zip(one, two, strict=True):
        assert b["total"] == pytest.approx(a["total"], rel=LOSS)
    images = torch.rand(4, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    answers = [predict(load_weights(tmp_path / name / WEIGHTS), images) for name in ("one", "two")]
    for a, b in zip(*answers, strict=True):
        assert float((a - b).abs().mean() / a.abs().mean()) < ANSWER


LOSS = 1e-3
ANSWER = 1e-3


def test_parts_of_a_batch_are_the_batch(tmp_path: Path) -> None:
    """To the bit, with every effect of a camera."""
    photo = PhotoOptions(blur=2.0, jpeg=0.5, grey=0.3)
    relit = RelitFaces(
        load_faces(write_spheres(tmp_path / "faces", 3)), 4, Augmentation(lights=4, photo=photo), 0
    )
    real = RealFaces(load_pseudo_labels(write_labels(tmp_path / "labels")), 2, RECIPE.real, 0)
    mixed = MixedFaces(relit, real)
    for step in range(3):
        whole, parts = mixed.batch(step), [mixed.batch(step, rank, 2) for rank in range(2)]
        for kind in ("labelled", "real"):
            for field, tensor in getattr(whole, kind)._asdict().items():
                joined = torch.cat([getattr(getattr(part, kind), field) for part in parts])
                torch.testing.assert_close(joined, tensor, rtol=0, atol=0, msg=f"{kind}.{field}")
        assert torch.equal(torch.cat([part.confidence for part in parts]), whole.confidence)


def test_a_batch_that_cannot_be_dealt_out_is_refused() -> None:
    assert [dealt(6, rank, 3) for rank in range(3)] == [slice(0, 2), slice(2, 4), slice(4, 6)]
    with pytest.raises(BadInput, match="5 images of a kind found, a multiple of the 2 processes"):
        dealt(5, 0, 2)


def test_a_process_alone_needs_no_one() -> None:
    with join("cpu") as team:
        assert team.leads
        assert team.any(True)
        assert not team.any(False)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_told(tmp_path: Path) -> None:
    recipe = replace(RECIPE, compute=replace(RECIPE.compute, device="cuda"))
    faces, labels = write_spheres(tmp_path / "faces", 2), write_labels(tmp_path / "labels")
    with pytest.raises(BadInput, match=r"compute\.device: 'cuda' found, but torch sees no GPU"):
        train(recipe, faces, tmp_path / "out", labels=labels, progress=False)
