"""Render faces, train a network on them, and use its weights: tiny, so that it runs in a minute."""

from dataclasses import replace

import sfsnet_dr as sf
from sfsnet_dr.scene.spec import CameraSpec, HeadSpec, SamplingSpec, SceneSpec
from sfsnet_dr.train.config import ModelRecipe

# Faces with ground truth and light transport. Yours: sf.load_scene("my_faces.toml").
scene = SceneSpec(
    "tiny",
    "anny",
    camera=CameraSpec(size=32),
    head=HeadSpec(subdivision=0),
    sampling=SamplingSpec(spp=4, paths_per_hit=1, max_bounces=0, directional_lights=2, reference_spp=4),
)
sf.synthesize("faces", scene, 3)

# Each batch is relit on the fly: no two images are equal.
recipe = sf.train.Recipe(steps=3, batch_size=2, model=ModelRecipe("sfsnet", stem=4, features=8, blocks=1))
recipe = replace(recipe, data=replace(recipe.data, size=32, num_lights=8))
result = sf.train.train(recipe, "faces", "network", progress=False)
print({term: round(value, 3) for term, value in result.final.items()})

network = sf.load_model(result.weights)
print(network.model.architecture, sum(p.numel() for p in network.model.parameters()), "parameters")
