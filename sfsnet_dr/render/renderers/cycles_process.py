"""Cycles as a program: one line of JSON in, one image out. Runs in Blender's Python, imports nothing of ours.

Settings follow measured agreement with Mitsuba; each that is not obvious says why.
"""

import json
import os
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

#: More than any path survives: throughput falls with the albedo at each bounce.
_ENDLESS = 128


def main():
    """Answer questions until there are no more; Blender's own lines go to standard error."""
    with os.fdopen(os.dup(1), "w") as answers:
        os.dup2(2, 1)
        show = Show()
        for line in sys.stdin:
            try:
                show.render(json.loads(line))
                said = {}
            except Exception as error:  # the asking side tells what happened
                said = {"error": f"{type(error).__name__}: {error}".splitlines()[-1]}
            print(json.dumps(said), file=answers, flush=True)


class Show:
    """The scene of the last question, kept for the next one."""

    def __init__(self):
        self.subject = self.light = None

    def render(self, question):
        """Answer one question."""
        if question["subject"] != self.subject:
            bpy.ops.wm.read_factory_settings(use_empty=True)
            add_surface(Path(question["subject"]))
            self.subject, self.light = question["subject"], None
        if question["light"] != self.light:
            set_light(Path(question["light"]))
            self.light = question["light"]
        choose(question["samples"], question["seed"], question["bounces"])
        np.save(question["out"], picture(), allow_pickle=False)


def add_surface(folder):
    """The mesh with its albedo and shading normals, and the camera."""
    with np.load(folder / "mesh.npz", allow_pickle=False) as arrays:
        vertices, faces, normals, albedo = (arrays[k] for k in ("vertices", "faces", "normals", "albedo"))
    mesh = bpy.data.meshes.new("surface")
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.astype(np.int32).ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    mesh.polygons.foreach_set("use_smooth", np.ones(len(faces), dtype=bool))
    mesh.update()
    # Exact, while normals_split_custom_set_from_vertices errs by up to 6e-4.
    exact = mesh.attributes.new("custom_normal", "FLOAT_VECTOR", "POINT")
    exact.data.foreach_set("vector", normals.astype(np.float32).ravel())
    colour = mesh.attributes.new("albedo", "FLOAT_VECTOR", "POINT")
    colour.data.foreach_set("vector", albedo.astype(np.float32).ravel())
    mesh.materials.append(lambertian())
    surface = bpy.data.objects.new("surface", mesh)
    # The offset bends shadow rays: it would make the error on a head nine times larger.
    surface.cycles.shadow_terminator_geometry_offset = 0.0
    surface.cycles.shadow_terminator_offset = 0.0
    bpy.context.scene.collection.objects.link(surface)
    told = json.loads((folder / "subject.json").read_text(encoding="utf-8"))["camera"]
    add_camera(told["distance"], told["size"])


def lambertian():
    """Diffuse reflection of the mesh's albedo, of what faces the ray by its shading normal.

    Cycles alone would shade the rest too. At a silhouette that is light which Mitsuba does not have.

    One difference stays: where a triangle faces away from a light and its shading normal does not, shadow
    rays of Cycles miss some of what Mitsuba's meet. That is 0.01 % of a head's light in the sun, up to 0.2 %
    of the mean in a block of 8 x 8 of 64 x 64 pixels. With flat normals both agree.
    """
    material = bpy.data.materials.new("lambertian")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    albedo, diffuse = nodes.new("ShaderNodeAttribute"), nodes.new("ShaderNodeBsdfDiffuse")
    albedo.attribute_name = "albedo"
    diffuse.inputs["Roughness"].default_value = 0.0
    links.new(albedo.outputs["Vector"], diffuse.inputs["Color"])
    place, cosine, faces = (nodes.new(f"ShaderNode{kind}") for kind in ("NewGeometry", "VectorMath", "Math"))
    cosine.operation, faces.operation = "DOT_PRODUCT", "GREATER_THAN"
    faces.inputs[1].default_value = 0.0
    links.new(place.outputs["Normal"], cosine.inputs[0])
    links.new(place.outputs["Incoming"], cosine.inputs[1])
    links.new(cosine.outputs["Value"], faces.inputs[0])
    shown, out = nodes.new("ShaderNodeMixShader"), nodes.new("ShaderNodeOutputMaterial")
    links.new(faces.outputs["Value"], shown.inputs["Fac"])
    links.new(diffuse.outputs["BSDF"], shown.inputs[2])
    links.new(shown.outputs["Shader"], out.inputs["Surface"])
    return material


def add_camera(distance, size):
    """Blender's cameras look along -z with y up when they are not turned, as ours does."""
    scene, lens = bpy.context.scene, bpy.data.cameras.new("camera")
    lens.sensor_fit = "HORIZONTAL"
    lens.angle_x = 2.0 * np.arctan(1.0 / distance)
    lens.clip_start, lens.clip_end = 1e-3 * distance, 10.0 * distance
    camera = bpy.data.objects.new("camera", lens)
    camera.location = (0.0, 0.0, distance)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.resolution_percentage = 100


def set_light(folder):
    """Suns and sky, in place of those before."""
    scene = bpy.context.scene
    for lamp in [each for each in scene.objects if each.type == "LIGHT"]:
        bpy.data.objects.remove(lamp)
    for world in list(bpy.data.worlds):
        bpy.data.worlds.remove(world)
    for image in list(bpy.data.images):
        bpy.data.images.remove(image)
    told = json.loads((folder / "light.json").read_text(encoding="utf-8"))
    for toward, irradiance in told["directional"]:
        add_sun(Vector(toward), irradiance)
    path = folder / "environment.npy"
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes.clear()
    if path.exists():
        add_sky(scene.world, np.load(path, allow_pickle=False))


def add_sun(toward, irradiance):
    """Energy times colour is the irradiance; light travels along the lamp's -z."""
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle = 1.0, 0.0
    sun.color = irradiance
    sun.cycles.max_bounces = 1024
    lamp = bpy.data.objects.new("sun", sun)
    lamp.rotation_mode = "QUATERNION"
    lamp.rotation_quaternion = toward.to_track_quat("Z", "Y")
    bpy.context.scene.collection.objects.link(lamp)


def add_sky(world, radiance):
    """The map by its own formula: Blender's node puts rows half a texel elsewhere (off by up to 1 %)."""
    height, width, _ = radiance.shape
    image = bpy.data.images.new("sky", width, height, alpha=False, float_buffer=True, is_data=True)
    filled = np.concatenate([radiance, np.ones((height, width, 1))], axis=2)[::-1]  # from the lowest row
    image.pixels.foreach_set(np.ascontiguousarray(filled, dtype=np.float32).ravel())
    image.pack()
    tree = world.node_tree
    nodes, links = tree.nodes, tree.links
    toward, parts = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeSeparateXYZ")
    links.new(toward.outputs["Generated"], parts.inputs["Vector"])
    x, y, z = (parts.outputs[axis] for axis in "XYZ")

    def math(operation, a, b=0.0):
        node = nodes.new("ShaderNodeMath")
        node.operation = operation
        for socket, value in zip(node.inputs, (a, b), strict=False):
            if isinstance(value, float):
                socket.default_value = value
            else:
                links.new(value, socket)
        return node.outputs["Value"]

    u = math("DIVIDE", math("ARCTAN2", x, math("MULTIPLY", z, -1.0)), 2 * np.pi)
    row = math("MULTIPLY", math("DIVIDE", math("ARCCOSINE", y), float(np.pi)), float(height - 1))
    v = math("SUBTRACT", 1.0, math("DIVIDE", math("ADD", row, 0.5), float(height)))
    place, look = nodes.new("ShaderNodeCombineXYZ"), nodes.new("ShaderNodeTexImage")
    links.new(u, place.inputs["X"])
    links.new(v, place.inputs["Y"])
    look.image, look.interpolation, look.extension = image, "Linear", "REPEAT"
    links.new(place.outputs["Vector"], look.inputs["Vector"])
    shine, out = nodes.new("ShaderNodeBackground"), nodes.new("ShaderNodeOutputWorld")
    links.new(look.outputs["Color"], shine.inputs["Color"])
    links.new(shine.outputs["Background"], out.inputs["Surface"])
    world.cycles.sampling_method = "MANUAL"
    world.cycles.sample_map_resolution = 1024
    world.cycles.max_bounces = 1024


def choose(samples, seed, bounces):
    """Everything that would make the image quicker, prettier and biased is turned off."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.film_transparent = True  # the sky itself is not seen
    scene.render.use_persistent_data = True
    scene.render.use_compositing = scene.render.use_sequencer = False
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples, cycles.seed = samples, seed
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_guiding = False
    cycles.use_light_tree = False
    cycles.sampling_pattern = "TABULATED_SOBOL"  # blue noise would correlate neighbouring pixels
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.light_sampling_threshold = 0.0
    cycles.use_fast_gi = False
    cycles.pixel_filter_type = "BOX"
    cycles.film_exposure = 1.0
    limit = _ENDLESS if bounces < 0 else bounces
    cycles.max_bounces = cycles.diffuse_bounces = limit
    cycles.glossy_bounces = cycles.transmission_bounces = cycles.volume_bounces = 0


def picture():
    """The rendered image (H, W, 3), float32, premultiplied by coverage, from the top row."""
    scene = bpy.context.scene
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_mode = "RGBA"
    scene.render.image_settings.color_depth = "32"
    size = scene.render.resolution_x
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder) / "image.exr")
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        image.colorspace_settings.name = "Non-Color"
        image.alpha_mode = "PREMUL"
        values = np.empty(4 * size * size, dtype=np.float32)
        image.pixels.foreach_get(values)
        bpy.data.images.remove(image)
    return np.ascontiguousarray(values.reshape(size, size, 4)[::-1, :, :3])


if __name__ == "__main__":
    main()
