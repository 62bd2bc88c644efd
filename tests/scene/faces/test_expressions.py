"""Expressions: bounded, symmetric but for a little, and the gaze turns both eyes to one side."""

from __future__ import annotations

import numpy as np

from sfsnet_dr.scene.faces.expressions import expression_weights, gaze_weights

ANNY = ("jawOpen", "mouthSmileLeft", "mouthSmileRight", "mouthPucker", "browInnerUp", "eyeBlinkLeft")
ICT = ("mouthSmile_L", "mouthSmile_R", "browInnerUp_L", "browInnerUp_R", "mouthPucker")
EYES = (*(f"eyeLook{way}_{side}" for way in ("In", "Out", "Up", "Down") for side in "LR"), "eyeBlink_L")


def _many(names: tuple[str, ...], probability: float = 1.0) -> np.ndarray:
    return np.array([expression_weights(names, np.random.default_rng(k), probability) for k in range(300)])


def test_no_expression_is_neutral() -> None:
    assert not _many(ANNY, 0.0).any()
    assert _many(ANNY).any(axis=0).all()


def test_weights_are_bounded_and_sides_alike() -> None:
    values = _many(ICT)
    assert values.min() >= 0.0
    assert values.max() <= 1.0
    for left, right in ((0, 1), (2, 3)):
        used = values[:, left] > 0
        np.testing.assert_array_equal(used, values[:, right] > 0)
        ratio = values[used, left] / values[used, right]
        assert 0.85 / 1.15 <= ratio.min() <= ratio.max() <= 1.15 / 0.85  # each side varies by 15 %


def test_nobody_smiles_and_pouts_at_once() -> None:
    values = _many(ICT)
    assert not ((values[:, 0] > 0) & (values[:, 4] > 0)).any()


def test_both_eyes_look_to_one_side() -> None:
    column = {name: k for k, name in enumerate(EYES)}
    values = np.array([gaze_weights(EYES, np.random.default_rng(k), (0.0, 0.2)) for k in range(200)])
    for turned, follows in (("Out_L", "In_R"), ("In_L", "Out_R"), ("Up_L", "Up_R"), ("Down_L", "Down_R")):
        np.testing.assert_array_equal(
            values[:, column[f"eyeLook{turned}"]], values[:, column[f"eyeLook{follows}"]]
        )
    assert not (values[:, column["eyeLookOut_L"]] * values[:, column["eyeLookIn_L"]]).any()
    assert values[:, :8].max() <= 0.5
    assert 0.0 < values[:, column["eyeBlink_L"]].max() <= 0.2
