"""Two processes train as one does."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from data.test_mixed_batch import RECIPE, write_labels
from helpers.spheres import write_spheres
from torch import Tensor

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.batch import shard
from sfsnet_dr.data.dataset import RelitFaces, load_faces
from sfsnet_dr.data.mixed_batch import MixedFaces, RealFaces
from sfsnet_dr.data.pseudo_labels import load_pseudo_labels
from sfsnet_dr.data.transforms.background import Augmentation
from sfsnet_dr.data.transforms.camera import PhotoOptions
from sfsnet_dr.models.inference import predict
from sfsnet_dr.models.weights import load_weights
from sfsnet_dr.train.distributed import ProcessGroup, join_process_group
from sfsnet_dr.train.logging import read_history
from sfsnet_dr.train.run import HISTORY, WEIGHTS
from sfsnet_dr.train.step import training_step
from sfsnet_dr.train.trainer import train

SCRIPT = """
import sys
sys.path.insert(0, sys.argv[1])
import torch
torch.set_num_threads(1)
from data.test_mixed_batch import RECIPE
from sfsnet_dr.train.trainer import train
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
    command = [sys.executable, "-c", SCRIPT, str(Path(__file__).parents[1]), *map(str, arguments)]
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
        _, told = process.communicate(timeout=280)
        assert process.returncode == 0, told


#: Relative difference of every step's loss: six times the largest seen, 1.7e-7.
LOSS = 1e-6
#: Mean difference of the answers after six steps, as a share of their mean size: four times 3.6e-4.
ANSWER = 1.5e-3


class Threads:
    """Stands in for ``torch.distributed`` where threads of this process play the processes."""

    def __init__(self, count: int) -> None:
        self.count, self.barrier = count, threading.Barrier(count, timeout=60)
        self.given: dict[int, Tensor] = {}
        self.place = threading.local()

    def all_reduce(self, tensor: Tensor) -> None:
        self.given[self.place.rank] = tensor.detach().clone()
        self.barrier.wait()
        total = torch.stack([self.given[rank] for rank in range(self.count)]).sum(0)
        self.barrier.wait()
        tensor.copy_(total)

    def get_world_size(self) -> int:
        return self.count

    def run(self, work: Callable[[int], object]) -> None:
        """Do something as each of the processes."""
        failed: list[BaseException] = []

        def member(rank: int) -> None:
            self.place.rank = rank
            try:
                work(rank)
            except BaseException as error:
                failed.append(error)
                self.barrier.abort()

        threads = [threading.Thread(target=member, args=(rank,)) for rank in range(self.count)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if failed:
            raise failed[0]


def test_a_step_of_two_is_the_step_of_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rendered and real faces, masks of different sizes in both halves, batch normalisation over both.

    In exact arithmetic all numbers are the same; the bounds allow for single precision alone.
    """
    faces, labels = write_spheres(tmp_path / "faces", 3), write_labels(tmp_path / "labels")
    relit = RelitFaces(load_faces(faces), 2, RECIPE.data, 0)
    batches = MixedFaces(relit, RealFaces(load_pseudo_labels(labels), 2, RECIPE.real, 0))
    alone = RECIPE.make_model()
    expected = training_step(alone, torch.optim.Adam(alone.parameters()), batches.batch(0), RECIPE, 1e-3)

    members = [RECIPE.make_model() for _ in range(2)]
    threads = Threads(2)
    told: list[dict[str, float]] = [{}, {}]
    for module in ("sfsnet_dr.train.distributed.dist", "sfsnet_dr.models.layers.dist"):
        monkeypatch.setattr(module, threads)

    def step(rank: int) -> None:
        team, model = ProcessGroup(rank, 2), members[rank]
        team.prepare(model)
        adam = torch.optim.Adam(model.parameters())
        told[rank] = training_step(model, adam, batches.batch(0, rank, 2), RECIPE, 1e-3, team)

    threads.run(step)
    assert told[0] == told[1]
    for name, value in expected.items():
        if not name.endswith("_spread"):  # means of two ratios are not the ratio of means
            assert told[0][name] == pytest.approx(value, rel=1e-5), name
    for model in members:
        for (name, wanted), found in zip(alone.named_buffers(), model.buffers(), strict=True):
            torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-6, msg=name)
        wanted, found = (torch.cat([p.grad.flatten() for p in m.parameters() if p.grad is not None])
                         for m in (alone, model))  # fmt: skip
        assert float((found - wanted).norm() / wanted.norm()) < 1e-4


@pytest.mark.slow
def test_two_processes_give_the_result_of_one(tmp_path: Path) -> None:
    """Rendered and real faces, masks of different sizes in both halves, batch normalisation over both.

    In exact arithmetic both are the same. Adam divides by the gradient's size, so that rounding grows with
    the steps where a gradient is 0 but for rounding.
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


def test_parts_of_a_batch_are_the_batch(tmp_path: Path) -> None:
    """To the bit, with every effect of a camera."""
    photo = PhotoOptions(blur=2.0, jpeg=0.5, grayscale_prob=0.3)
    relit = RelitFaces(
        load_faces(write_spheres(tmp_path / "faces", 3)), 4, Augmentation(num_lights=4, photo=photo), 0
    )
    real = RealFaces(load_pseudo_labels(write_labels(tmp_path / "labels")), 2, RECIPE.real, 0)
    mixed = MixedFaces(relit, real)
    for step in range(3):
        whole, parts = mixed.batch(step), [mixed.batch(step, rank, 2) for rank in range(2)]
        tensors = [(*batch.labelled, *batch.real.faces, *batch.real[1:]) for batch in (whole, *parts)]
        for planes, *pieces in zip(*tensors, strict=True):
            assert torch.equal(torch.cat(pieces), planes)


def test_a_batch_that_cannot_be_dealt_out_is_refused() -> None:
    assert [shard(6, rank, 3) for rank in range(3)] == [slice(0, 2), slice(2, 4), slice(4, 6)]
    with pytest.raises(InputError, match="5 images of a kind found, a multiple of the 2 processes"):
        shard(5, 0, 2)


def test_a_process_alone_needs_no_one() -> None:
    with join_process_group("cpu") as team:
        assert team.is_main_process
        assert team.any(True)
        assert not team.any(False)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_told(tmp_path: Path) -> None:
    recipe = replace(RECIPE, compute=replace(RECIPE.compute, device="cuda"))
    faces, labels = write_spheres(tmp_path / "faces", 2), write_labels(tmp_path / "labels")
    with pytest.raises(InputError, match=r"compute\.device: 'cuda' found, but torch sees no GPU"):
        train(recipe, faces, tmp_path / "out", labels=labels, progress=False)
