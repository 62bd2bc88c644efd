"""What `synth` refuses before it renders anything, and the scene that its options mean."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

import pytest
from data.test_generate import ROOT, TINY

from sfsnet_dr.cli.faces import Synth
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.generate import synthesize
from sfsnet_dr.scene.spec import SceneSpec, load_scene


def test_two_runs_do_not_write_into_one_folder(tmp_path: Path) -> None:
    handle = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    with pytest.raises(InputError, match="another run is writing here"):
        synthesize(tmp_path, TINY, 1)
    os.close(handle)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("spec", "count", "words"),
    [
        (TINY, 0, "count 0"),
        (SceneSpec("ball", "sphere"), 1, "shape 'sphere' found"),
        (SceneSpec("faces", "ict"), 1, "model_path is missing"),
        (SceneSpec("faces", "ict", model_path="absent.npz"), 1, "absent.npz"),
    ],
)
def test_what_cannot_be_a_dataset_is_refused(tmp_path: Path, spec: SceneSpec, count: int, words: str) -> None:
    with pytest.raises(InputError, match=words):
        synthesize(tmp_path / "out", spec, count)
    assert not (tmp_path / "out").exists()


def test_the_command_builds_the_scene() -> None:
    out = Path("out")
    assert Synth(out).spec() == load_scene(ROOT / "scenes" / "faces.toml")
    spec = Synth(out, face_model="ict", model_path=Path("ict.npz")).spec()
    assert (spec.shape, spec.model_path) == ("ict", "ict.npz")
    assert Synth(out, scene=ROOT / "scenes" / "validation" / "head.toml").spec().name == "head"
