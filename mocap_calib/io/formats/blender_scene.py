"""Builds a recording in Blender: bodies, cameras and the floor.

Run it with `blender --python FILE`, or open it in Blender's text editor and press Run. Each run
makes a scene of its own. For Blender 3.4 or newer. Written by mocap-calib.
"""

import base64
import json
import zlib
from typing import Any

import bmesh
import bpy
from mathutils import Matrix

SCENE = ""  # zlib, base64: the JSON of what is built

COLOURS = ((0.9, 0.35, 0.1), (0.1, 0.45, 0.9), (0.15, 0.7, 0.3), (0.75, 0.2, 0.75), (0.9, 0.8, 0.1))


def build(said: dict[str, Any]) -> Any:
    """Build the scene that the data describe, and show it."""
    scene = bpy.data.scenes.new(said["title"])
    if bpy.context.window is not None:
        bpy.context.window.scene = scene
    first, last = said["frames"][0], said["frames"][-1]
    scene.frame_start, scene.frame_end = first, last
    scene.frame_set(first)
    if said["fps"]:
        scene.render.fps = max(1, round(said["fps"]))
        scene.render.fps_base = scene.render.fps / said["fps"]
    for number, body in enumerate(said["bodies"]):
        build_body(scene, said, body, COLOURS[number % len(COLOURS)])
    if said["cameras"]:
        home = new_collection(scene, "cameras")
        cameras = [build_camera(home, each, said["size"]) for each in said["cameras"]]
        look_through(scene, cameras[0])
    if said["floor"] is not None:
        build_floor(scene, said["floor"], said["size"])
    return scene


def new_collection(scene: Any, name: str) -> Any:
    """Return a collection of its own in the scene."""
    made = bpy.data.collections.new(name)
    scene.collection.children.link(made)
    return made


# --- bodies


def build_body(
    scene: Any, said: dict[str, Any], body: dict[str, Any], colour: tuple[float, float, float]
) -> None:
    """Build a sphere for each keypoint, and an armature whose bones are stretched between them."""
    home = new_collection(scene, body["name"])
    material = bpy.data.materials.new(body["name"])
    material.diffuse_color = (*colour, 1.0)
    mesh = make_sphere(body["name"], said["radius"])
    mesh.materials.append(material)
    points = []
    for name, track in zip(said["keypoints"], body["tracks"], strict=True):
        point = bpy.data.objects.new(body["name"] + " " + name, mesh)
        home.objects.link(point)
        animate(point, said["frames"], track)
        points.append(point)
    if said["edges"]:
        build_bones(scene, home, body, points, said)


def make_sphere(name: str, radius: float) -> Any:
    """Return the mesh of a sphere."""
    mesh = bpy.data.meshes.new(name)
    ball = bmesh.new()
    bmesh.ops.create_icosphere(ball, subdivisions=2, radius=radius)
    ball.to_mesh(mesh)
    ball.free()
    return mesh


def animate(point: Any, frames: list[int], track: list[Any]) -> None:
    """Move a point along a track: a place for each frame, None where it is missing.

    It is hidden where it is missing.
    """
    there = [k for k, place in enumerate(track) if place is not None]
    curves = make_curves(point)
    for axis in range(3):
        keys = [(frames[k], track[k][axis]) for k in there]
        add_keys(curves.new("location", index=axis), keys, "LINEAR")
    hidden = [place is None for place in track]
    changes = [k for k, now in enumerate(hidden) if k == 0 or now != hidden[k - 1]]
    if any(hidden):
        for path in ("hide_viewport", "hide_render"):
            keys = [(frames[k], float(hidden[k])) for k in changes]
            add_keys(curves.new(path), keys, "CONSTANT")


def make_curves(thing: Any) -> Any:
    """Return the curves of a new action, in the way of this version of Blender."""
    action = bpy.data.actions.new(thing.name)
    owner = thing.animation_data_create()
    owner.action = action
    if not hasattr(action, "layers"):  # before 4.4
        return action.fcurves
    slot = action.slots.new("OBJECT", thing.name)
    owner.action_slot = slot
    strip = action.layers.new("poses").strips.new(type="KEYFRAME")
    return strip.channelbag(slot, ensure=True).fcurves


def add_keys(curve: Any, keys: list[tuple[int, float]], interpolation: str) -> None:
    """Fill a curve with (frame, value) pairs."""
    curve.keyframe_points.add(len(keys))
    curve.keyframe_points.foreach_set("co", [number for key in keys for number in key])
    for point in curve.keyframe_points:
        point.interpolation = interpolation
    curve.update()


def build_bones(
    scene: Any, home: Any, body: dict[str, Any], points: list[Any], said: dict[str, Any]
) -> None:
    """Build an armature with a bone for each edge, which follows the points at its ends."""
    armature = bpy.data.armatures.new(body["name"] + " bones")
    armature.display_type = "STICK"
    rig = bpy.data.objects.new(body["name"] + " bones", armature)
    home.objects.link(rig)
    layer = scene.view_layers[0]
    layer.objects.active = rig
    with bpy.context.temp_override(
        scene=scene, view_layer=layer, object=rig, active_object=rig, selected_objects=[rig]
    ):
        bpy.ops.object.mode_set(mode="EDIT")
        for (a, b), length in zip(said["edges"], body["lengths"], strict=True):
            bone = armature.edit_bones.new(said["keypoints"][a] + "-" + said["keypoints"][b])
            bone.head = (0.0, 0.0, 0.0)
            bone.tail = (0.0, length, 0.0)
        names = [bone.name for bone in armature.edit_bones]
        bpy.ops.object.mode_set(mode="OBJECT")
    for name, (a, b) in zip(names, said["edges"], strict=True):
        bone = rig.pose.bones[name]
        bone.constraints.new("COPY_LOCATION").target = points[a]
        bone.constraints.new("STRETCH_TO").target = points[b]


# --- cameras and the floor


def build_camera(home: Any, said: dict[str, Any], size: float) -> Any:
    """Build a camera with the intrinsics and the place of one of the rig; lenses are not bent."""
    data = bpy.data.cameras.new(said["name"])
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = 36.0
    data.lens = said["lens"] * data.sensor_width
    data.shift_x, data.shift_y = said["shift"]
    data.clip_start, data.clip_end = 0.001 * size, 100.0 * size
    data.display_size = 0.05 * size
    camera = bpy.data.objects.new(said["name"], data)
    for key in ("width", "height", "aspect_x", "aspect_y"):
        camera[key] = said[key]
    camera.matrix_world = Matrix(said["matrix"])
    home.objects.link(camera)
    return camera


def look_through(scene: Any, camera: Any) -> None:
    """Show what a camera sees: its view, the size of its images and the shape of their pixels."""
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = camera["width"], camera["height"]
    scene.render.resolution_percentage = 100
    scene.render.pixel_aspect_x = camera["aspect_x"]
    scene.render.pixel_aspect_y = camera["aspect_y"]


def build_floor(scene: Any, centre: list[float], size: float) -> None:
    """Build a square of the floor, z up."""
    mesh = bpy.data.meshes.new("floor")
    corners = [(-size, -size, 0), (size, -size, 0), (size, size, 0), (-size, size, 0)]
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    floor = bpy.data.objects.new("floor", mesh)
    floor.location = centre
    floor.display_type = "WIRE"
    scene.collection.objects.link(floor)


if __name__ == "__main__":
    build(json.loads(zlib.decompress(base64.b64decode(SCENE))))
