"""Decompose one picture of a face, look at its parts, and relight it.

A rendered face stands in for a photograph; ``sf.decompose("me.jpg", eyes=((201, 190), (255, 188)))`` takes
yours.
"""

import numpy as np

import sfsnet_dr as sf
from sfsnet_dr.core.visualize import png_bytes, show_linear, show_normals

# A rendered head whose normals are known.
scene = sf.load_scene("head")
subject = sf.build_subject(scene, seed=0)
picture = sf.path_trace(subject, sf.sample_light(3, "ambient"), samples=16).mean
truth = sf.render_aovs(subject, samples=4, order=0)

# Normals, albedo and light by the network that comes with the package.
face = sf.decompose(picture, sf.load_model("skipnet"), mask=truth.mask)
error = sf.metrics.angular_error_deg(face.normal, truth.normal, truth.mask)
print(f"normals: {error.mean:.1f} degrees from the truth")
print(f"light: {face.light.flat().round(2)[:9]} (red)")

# The face under a light from the left.
relit = face.relight(sf.Light.from_direction((-1, 0.3, 0.6)))
with open("relit.png", "wb") as file:
    file.write(png_bytes(np.hstack([show_linear(picture), show_normals(face.normal), show_linear(relit)])))
face.save("decomposition")
