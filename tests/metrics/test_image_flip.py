"""FLIP where it is installed; the command that installs it where it is not."""

from __future__ import annotations

import numpy as np
import pytest

from sfsnet_dr.core.errors import InputError
from sfsnet_dr.metrics.image import flip_metric, has_flip

IMAGE = np.full((16, 16, 3), 0.2)


@pytest.mark.skipif(not has_flip(), reason="flip-evaluator is not installed")
def test_equal_images_score_0_and_only_the_mask_counts() -> None:
    mask = np.ones((16, 16))
    other = IMAGE.copy()
    other[:8] = 0.9
    assert flip_metric(IMAGE, IMAGE, mask) == 0
    assert flip_metric(other, IMAGE, mask) > 0.1
    mask[:8] = 0
    assert flip_metric(other, IMAGE, mask) == 0


@pytest.mark.skipif(has_flip(), reason="flip-evaluator is installed")
def test_without_the_package_the_command_is_named() -> None:
    with pytest.raises(InputError, match="not installed; pip install flip-evaluator"):
        flip_metric(IMAGE, IMAGE, np.ones((16, 16)))
