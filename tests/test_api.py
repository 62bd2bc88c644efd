"""``import sfsnet_dr as sf``: its names, their documentation, their examples, and their types for users."""

from __future__ import annotations

import ast
import doctest
import importlib
import inspect
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from helpers.spheres import sphere_bundle

import sfsnet_dr as sf
from sfsnet_dr.core.errors import InputError
from sfsnet_dr.data.bundle import write_bundle

PACKAGE = Path(sf.__file__).parent

NAMES = {
    "load_model", "decompose", "relight", "shade", "Decomposition", "Light", "load_scene", "build_subject",
    "sample_light", "path_trace", "render_aovs", "Transport", "relight_transport", "synthesize", "load_faces",
    "RelitFaces", "SfSNet", "SkipNet", "SkipNetPlus", "sfsnet_loss", "metrics", "sh", "train",
    "find_renderer", "validate", "Record",
}  # fmt: skip

FUNCTIONS = sorted(name for name in NAMES if inspect.isfunction(getattr(sf, name)))


def test_dir_lists_the_public_names() -> None:
    assert set(dir(sf)) == set(sf.__all__) == NAMES


def test_other_names_are_no_attributes() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        sf.no_such_name  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize("room", ["sh", "metrics", "train"])
def test_rooms_offer_the_names_of_their_stub(room: str) -> None:
    module = importlib.import_module(f"sfsnet_dr.{room}")
    stub = ast.parse((PACKAGE / room / "__init__.pyi").read_text(encoding="utf-8"))
    names = {alias.name for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert set(dir(module)) == names
    for name in names:
        assert inspect.getdoc(getattr(module, name)), f"{room}.{name} has no docstring"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_documents_arguments_result_errors_and_an_example(name: str) -> None:
    function = getattr(sf, name)
    text = inspect.getdoc(function) or ""
    for part in ("Args:", "Returns:", "Raises:", "Example:"):
        assert part in text, f"{name}: {part} is missing"
    assert "Source:" in text or name not in ("shade", "decompose", "sfsnet_loss")
    arguments = text[text.index("Args:") :].split("Returns:")[0]
    for parameter in inspect.signature(function).parameters:
        assert f"{parameter}:" in arguments or f"{parameter}," in arguments, f"{name}: {parameter}"


def objects() -> list[tuple[str, Any]]:
    """Public functions and classes with the methods that users call."""
    found = []
    for name in sorted(NAMES):
        thing = getattr(sf, name)
        if not isinstance(thing, ModuleType):
            found.append((name, thing))
    return found


@pytest.mark.parametrize(("name", "thing"), objects(), ids=[name for name, _ in objects()])
def test_examples_run(name: str, thing: Any) -> None:
    tests = [t for t in doctest.DocTestFinder().find(thing, name) if t.examples]
    if inspect.isfunction(thing):
        assert tests
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    messages: list[str] = []
    for test in tests:
        runner.run(test, out=messages.append)
    assert runner.failures == 0, "".join(messages)


CLIENT = """
import numpy as np
import torch
import sfsnet_dr as sf

model: sf.models_LoadedModel  # replaced below
face = sf.decompose("me.jpg", "skipnet", eyes=((201.0, 190.0), (255.0, 188.0)))
normal: np.ndarray = face.normal
relit = face.relight(sf.Light.from_direction((1, 0, 1)))
subject = sf.build_subject(sf.load_scene("head"), seed=3)
light = sf.sample_light(1, "studio")
mean: np.ndarray = sf.path_trace(subject, light, samples=16).mean
maps = sf.render_aovs(subject, directions=np.eye(3))
image = sf.Transport.of(maps, np.eye(3)).relight(light)
same = sf.relight_transport(sf.Transport.of(maps), light)
shaded: torch.Tensor = sf.shade(torch.zeros(1, 3, 8, 8), torch.zeros(27), torch.ones(1, 3, 8, 8))
array: np.ndarray = sf.shade(np.zeros((8, 8, 3)), light)
angle: float = sf.metrics.angular_error_deg(normal, normal, np.ones(normal.shape[:2])).mean
coefficients: sf.sh.Shading = light.coefficients(2).to_shading()
recipe = sf.train.read_recipe("recipe.toml")
records: list[sf.Record] = sf.validate("sphere", "out")
renderer = sf.find_renderer("drjit-order2")
network = sf.SkipNet(8)
print(renderer.name, relit.shape, network(torch.zeros(1, 3, 128, 128)).normal)
""".replace("model: sf.models_LoadedModel  # replaced below", "model = sf.load_model()")


def check_types(text: str, folder: Path) -> str:
    (folder / "client.py").write_text(text)
    command = [sys.executable, "-m", "mypy", "--strict", "--ignore-missing-imports", "client.py"]
    cache = PACKAGE.parent / ".mypy_cache"
    done = subprocess.run(
        [*command, "--cache-dir", str(cache / "client")],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        env={"MYPYPATH": str(PACKAGE.parent), "PATH": ""},
    )
    return done.stdout


@pytest.mark.slow
def test_a_strict_client_type_checks(tmp_path: Path) -> None:
    found = check_types(CLIENT, tmp_path)
    errors = [line for line in found.splitlines() if line.startswith("client.py")]
    assert errors == [], found
    wrong = check_types(CLIENT + "sf.shade('text', light)\nsf.no_such_name\n", tmp_path)
    assert "No overload variant" in wrong
    assert 'has no attribute "no_such_name"' in wrong


def test_shading_takes_images_batches_and_tensors_alike() -> None:
    rng = np.random.default_rng(0)
    normal, albedo = rng.normal(size=(2, 4, 5, 3)), rng.uniform(size=(2, 4, 5, 3))
    light = sf.sample_light(1, "ambient")
    batch = sf.shade(normal, light, albedo)
    np.testing.assert_allclose(sf.shade(normal[1], light, albedo[1]), batch[1])
    np.testing.assert_allclose(sf.shade(normal, light) * albedo, batch)
    flat = light.shading_label().flat()
    np.testing.assert_allclose(sf.shade(normal, flat, albedo), batch)
    planes = [torch.from_numpy(np.moveaxis(part, -1, 1)) for part in (normal, albedo)]
    tensors = sf.shade(planes[0], torch.from_numpy(flat), planes[1])
    np.testing.assert_allclose(np.moveaxis(tensors.numpy(), 1, -1), batch)
    with pytest.raises(InputError, match="normal: shape"):
        sf.shade(normal[..., :2], light)


def test_decompose_takes_arrays_batches_and_tensors_alike() -> None:
    model = sf.load_model("skipnet")
    images = np.random.default_rng(0).uniform(0.2, 0.6, (2, 128, 128, 3)).astype(np.float32)
    faces = sf.decompose(images, model)
    assert isinstance(faces, list)
    one = sf.decompose(images[1], model)
    assert isinstance(one, sf.Decomposition)
    # Sums of one image and of two are added in another order.
    np.testing.assert_allclose(one.normal, faces[1].normal, atol=1e-4)
    planes = sf.decompose(torch.from_numpy(np.moveaxis(images[1], -1, 0)), model)
    assert isinstance(planes, sf.Decomposition)
    np.testing.assert_array_equal(planes.normal, one.normal)
    from sfsnet_dr.core.color import linear_to_srgb

    encoded = np.round(linear_to_srgb(images[1]) * 65535).astype(np.uint16)
    again = sf.decompose(encoded, model)
    assert isinstance(again, sf.Decomposition)
    np.testing.assert_allclose(again.normal, one.normal, atol=1e-3)
    assert one.to_torch()["normal"].shape == (1, 3, 128, 128)
    for wrong, words in ((images[0, :64], "128 x 128"), (images[..., 0], "image: shape")):
        with pytest.raises(InputError, match=words):
            sf.decompose(wrong, model)


def test_relight_takes_decompositions_transport_bundles_and_files(tmp_path: Path) -> None:
    bundle = sphere_bundle(0)
    light = sf.Light.from_direction(bundle.directions[0])
    write_bundle(tmp_path / "face.exr", bundle)
    expected = sf.Transport.of(bundle).relight(light)
    np.testing.assert_array_equal(sf.relight(bundle, light), expected)
    np.testing.assert_allclose(sf.relight(tmp_path / "face.exr", light), expected, atol=2e-3)  # half floats
    with pytest.raises(TypeError, match="int found"):
        sf.relight(3, light)  # type: ignore[arg-type]


def test_what_can_be_seen_shows_itself_in_notebooks() -> None:
    png = b"\x89PNG\r\n\x1a\n"
    subject = sf.build_subject("sphere")
    light = sf.Light.from_direction((0, 0, 1))
    assert light._repr_png_().startswith(png)
    assert sf.path_trace(subject, light, samples=2)._repr_png_().startswith(png)
    assert sf.render_aovs(subject, samples=4, order=0)._repr_png_().startswith(png)
    face = sf.decompose(np.full((128, 128, 3), 0.3))
    assert isinstance(face, sf.Decomposition)
    assert face._repr_png_().startswith(png)
    record = sf.Record("a.b", 1.5, "<unit>", (1, 2))
    assert record._repr_html_() == (
        "<table><tr><td>a.b</td><td>1.5</td><td>1 to 2</td><td>&lt;unit&gt;</td></tr></table>"
    )


def test_lights_are_made_from_directions_and_maps() -> None:
    lamp = sf.Light.from_direction((0, 0, 2), irradiance=(1, 2, 3))
    np.testing.assert_array_equal(lamp.directional[0][0], [0, 0, 1])
    np.testing.assert_array_equal(lamp.directional[0][1], [1, 2, 3])
    assert sf.Light.from_environment(np.ones((64, 128, 3))).environment is not None
    with pytest.raises(InputError, match="length 0"):
        sf.Light.from_direction((0, 0, 0))
    with pytest.raises(InputError, match="did you mean 'studio'"):
        sf.sample_light(0, "studi")
