"""How wrong is SH shading on a scene, and which is the cheapest model that is good enough?"""

import sfsnet_dr as sf
from sfsnet_dr.render.renderers.base import Budget

# Two lights, few samples and small images for a first look; leave these out for real numbers.
records = sf.validate(
    "two_spheres", "validation", lights="natural0,directional60", samples=16, size=32, tolerance=0.1
)

for record in records:
    if record.what.endswith("natural0.rel_rmse"):
        print(f"{record.what:60} {100 * record.value:5.1f} %")

# Any registered renderer by its name, on the same subject and light.
subject, light = sf.build_subject("two_spheres"), sf.sample_light(0, "directional")
cheap = sf.find_renderer("numpy-order2").render(subject, light, Budget())
exact = sf.path_trace(subject, light, samples=32).mean
print(f"one lamp: {100 * sf.metrics.rel_rmse(cheap, exact):.0f} % off")
