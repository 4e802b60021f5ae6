"""A scene from a JSON file: meshes by path or simple shapes, each with material and heat.

docs/files.md describes all its keys.
"""

import re
import reprlib
import sys
from dataclasses import fields, replace
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh

from ..errors import InputError
from ..machinery.json_file import read_json
from ..sky import Atmosphere, usual_atmosphere
from .geometry import mesh, value_noise
from .refined import refined
from .scene import Camera, Scene, SceneObject

CREASE_DEG = 40.0  # between facets of a file, from which on an edge is sharp
LEAST_M = 1.0  # edges of a shape are no longer than this, or than its distance if that is more
# where its temperature varies, than shares of the distance and of scale_m, or than this
OF_DISTANCE, OF_SCALE, LEAST_OF_NOISE_M = 0.02, 0.25, 1e-3
CELSIUS_K = 100.0  # no K of any scene
OVERLAP = 1e-3  # of a polygon's area, as by rounding
PLY_CORNERS = "vertex_indices", "vertex_index"
ASCII_ALONE = bytes(range(128)) + b"?" * 128
PLANE = [[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]]

# shape: its dimensions with how many numbers each has (None: one plain number), and a maker
SHAPES = {
    "box": ({"size": 3}, lambda size: trimesh.creation.box(extents=size)),
    "sphere": (
        {"radius": None},
        lambda radius: trimesh.creation.icosphere(subdivisions=4, radius=radius),
    ),
    "plane": (
        {"size": 2},
        lambda size: trimesh.Trimesh(
            np.multiply(PLANE, (*size, 0)), [[0, 1, 2], [0, 2, 3]], process=False
        ),
    ),
    "cylinder": (
        {"radius": None, "height": None},
        lambda radius, height: trimesh.creation.cylinder(radius, height, sections=64),
    ),
}


def load_scene(path):
    """Read a scene file (see the module) -> Scene; InputError says what is wrong."""
    path = Path(path)
    data = read_json(path, "scene")
    try:
        _keys(data, "the file", ("camera", "objects"), ("atmosphere", "sun_direction", "name"))
        camera = data["camera"]
        _keys(camera, "camera", ("position", "target"), ("fov_deg",))
        if not isinstance(data["objects"], list) or not data["objects"]:
            raise InputError("scene: 'objects' must list at least one object.")
        lens = Camera(
            _numbers(camera["position"], 3, "camera position"),
            _numbers(camera["target"], 3, "camera target"),
            _numbers(camera.get("fov_deg", 40.0), None, "camera fov_deg"),
        )
        sun = {}
        if "sun_direction" in data:
            sun["sun_direction"] = _numbers(data["sun_direction"], 3, "sun_direction")
        atmosphere = data.get("atmosphere")
        if atmosphere is not None:
            _keys(atmosphere, "atmosphere", (), tuple(f.name for f in fields(Atmosphere)))
            given = {k: _numbers(v, None, f"atmosphere {k}") for k, v in atmosphere.items()}
            air_k = given.get("air_temperature_k", Atmosphere.air_temperature_k)
            atmosphere = Atmosphere(**{"water_cm": usual_atmosphere(air_k).water_cm} | given)
        objects = [_object(o, i, path.parent, lens.position) for i, o in enumerate(data["objects"])]
        return Scene(objects, lens, atmosphere, name=str(data.get("name", path.stem)), **sun)
    except InputError as e:
        raise InputError(f"{str(e).rstrip('.')} (in {path}).") from e


def _keys(data, what, required, optional):
    """InputError unless data is an object with the required and no unknown keys."""
    if not isinstance(data, dict):
        raise InputError(f"scene: {what} must be a JSON object.")
    for key in required:
        if key not in data:
            raise InputError(f"scene: {what} lacks {key!r}.")
    for key in data:
        if key not in required + optional:
            known = ", ".join(required + optional)
            raise InputError(f"scene: {what} has an unknown key {key!r}; it may have {known}.")


def _numbers(value, n, what):
    """A float (n None) or a tuple of n floats, finite; else InputError."""
    wanted = "a number" if n is None else f"{n} numbers"
    values = [value] if n is None else value
    good = isinstance(values, list) and len(values) == (n or 1)
    good = good and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values)
    if not good or not all(abs(v) <= sys.float_info.max for v in values):  # an int may be larger
        raise InputError(f"scene: {what} must be {wanted}, got {reprlib.repr(value)}.")
    return float(value) if n is None else tuple(float(v) for v in value)


def _object(data, index, folder, eye):
    label = f"object {index}"
    optional = ("name", "translate", "scale", "rotate_z_deg", "smooth", "mirror")
    _keys(data, label, ("mesh", "material", "temperature_k"), optional)
    label = f"object {str(data.get('name', index))!r}"
    m, of_file = _mesh(data["mesh"], label, folder), isinstance(data["mesh"], str)
    smooth = data.get("smooth", of_file or data["mesh"]["shape"] == "sphere")
    if not isinstance(smooth, bool):
        raise InputError(f"scene: {label}: smooth must be true or false, got {smooth!r}.")
    scale = _numbers(data.get("scale", 1.0), None, f"{label} scale")
    if scale <= 0:
        raise InputError(f"scene: {label} scale must be positive, got {scale:g}.")
    turn = np.radians(_numbers(data.get("rotate_z_deg", 0.0), None, f"{label} rotate_z_deg"))
    place = trimesh.transformations.rotation_matrix(turn, [0, 0, 1])
    place[:3, :3] *= scale
    place[:3, 3] = _numbers(data.get("translate", [0, 0, 0]), 3, f"{label} translate")
    m.apply_transform(place)
    if (
        of_file
        and data["mesh"].lower().endswith(".stl")
        and isinstance(data["temperature_k"], list)
    ):
        raise InputError(
            f"scene: {label}: an STL file has no vertices of its own to list temperature_k for; "
            "give a number or a field, or take OBJ or PLY."
        )
    temperature_k, noise = _temperature(data["temperature_k"], m, label)
    name = str(data.get("name", f"object {index}"))
    mirror = _numbers(data.get("mirror", 0.0), None, f"{label} mirror")
    built = SceneObject(m, str(data["material"]), temperature_k, smooth, name, mirror)
    if not of_file and not smooth:
        built = _refined(built, noise, eye)
    if noise is not None:
        more = noise.amplitude_k * value_noise(built.mesh.vertices, noise.scale_m, noise.seed)
        built = replace(built, temperature_k=built.temperature_k + more)
    if of_file and smooth:
        built = _welded(built)
    if data.get("smooth") and not built.mesh.is_winding_consistent:
        raise InputError(
            f"scene: {label}: its triangles are wound both ways, so that normals cannot be "
            "interpolated; wind them consistently, or set smooth to false."
        )
    coldest = built.temperature_k.min()
    if coldest < CELSIUS_K:
        raise InputError(
            f"scene: {label} temperature_k is as low as {coldest:g}; give K, not degrees Celsius."
        )
    return _creased(built) if of_file and "smooth" not in data else built


def _refined(built, noise, eye):
    """A SceneObject with edges so short that noise varies between vertices as it should, and that
    light is taken close above a wide ground: by a share of a triangle's coordinates (`trace`)."""

    def longest(middle):
        away = np.linalg.norm(middle - eye, axis=1)
        limit = np.maximum(away, LEAST_M)
        if noise is None:
            return limit
        of_noise = np.maximum(OF_DISTANCE * away, OF_SCALE * noise.scale_m)
        return np.minimum(limit, np.maximum(of_noise, LEAST_OF_NOISE_M))

    columns = np.column_stack([built.mesh.vertices, built.temperature_k])
    columns, faces = refined(columns, np.asarray(built.mesh.faces), longest)
    return replace(built, mesh=mesh(columns[:, :3], faces), temperature_k=columns[:, 3])


def _mesh(data, label, folder):
    if isinstance(data, str):
        file = folder / data
        if not file.is_file():
            raise InputError(f"scene: {label}: there is no mesh file {file}.")
        kind = file.suffix[1:].lower()
        if kind not in READERS:
            raise InputError(f"scene: {label}: {file} must be an OBJ, a PLY or an STL.")
        try:
            m = READERS[kind](file)
        except (ValueError, OSError) as e:
            raise InputError(f"scene: {label}: cannot read {file} as a mesh ({e}).") from e
        if len(m.faces) == 0:
            raise InputError(f"scene: {label}: {file} holds no triangles.")
        return m
    if not isinstance(data, dict) or data.get("shape") not in tuple(SHAPES):
        shapes = ", ".join(SHAPES)
        raise InputError(f"scene: {label}: mesh must be a file or have a shape from {shapes}.")
    dimensions, make = SHAPES[data["shape"]]
    _keys(data, f"{label} mesh", ("shape", *dimensions), ())
    given = {k: _numbers(data[k], n, f"{label} {k}") for k, n in dimensions.items()}
    if not all(np.min(v) > 0 for v in given.values()):
        raise InputError(f"scene: {label}: {' and '.join(given)} must be positive.")
    return make(**given)


def _welded(built):
    """A SceneObject with one vertex for all that lie in a place and are as warm, as files have them
    on both sides of a texture's seam, so that normals are interpolated across it."""
    columns = np.column_stack([built.mesh.vertices, built.temperature_k])
    columns, of = np.unique(columns, axis=0, return_inverse=True)
    m = trimesh.Trimesh(columns[:, :3], of[built.mesh.faces], process=False)
    return replace(built, mesh=m, temperature_k=columns[:, 3])


def _creased(built):
    """A SceneObject whose triangles share a vertex only where edges that are not sharp lead from
    one to the other around it."""
    m = built.mesh
    alike = m.face_adjacency_angles < np.radians(CREASE_DEG)
    pairs, edges = m.face_adjacency[alike], m.face_adjacency_edges[alike]
    corner = lambda f: 3 * f[:, None] + np.argmax(m.faces[f][:, None] == edges[..., None], axis=2)
    same = np.stack([corner(pairs[:, 0]), corner(pairs[:, 1])], axis=-1).reshape(-1, 2)
    part = trimesh.graph.connected_component_labels(same, m.faces.size)
    _, first, faces = np.unique(part, return_index=True, return_inverse=True)
    vertex = m.faces.ravel()[first]
    split = trimesh.Trimesh(m.vertices[vertex], faces.reshape(-1, 3), process=False)
    return replace(built, mesh=split, temperature_k=built.temperature_k[vertex])


def _read_ply(file):
    """A PLY's vertices as the file has them, so that per-vertex temperatures fit."""
    raw = file.read_bytes()
    # fix_texture: it would order and split vertices by their seams
    m = _by_trimesh(raw, max(0, raw.find(b"end_header")), "ply", fix_texture=False)
    polygons = {}
    for corners in _ply_faces(m.metadata["_ply_raw"].get("face", {}).get("data", {})):
        polygons.setdefault(len(corners), []).append(corners)
    if polygons.keys() <= {3}:
        return m
    return _of_polygons(m.vertices, polygons, first=0)


def _ply_faces(data):
    """The corners of each face, of what trimesh keeps of a PLY's: an array by name, of as many
    corners each, with their number if binary, or of lists."""
    if isinstance(data, dict):
        name = next((name for name in PLY_CORNERS if name in data), None)
        return [] if name is None else data[name]
    names = data.dtype.names
    name = names[0] if len(names) == 1 else next(n for n in names if n in PLY_CORNERS)
    return data[name]["f1"]


def _read_stl(file):
    """An STL, which has no vertices of its own, with one for all corners in a place."""
    raw = file.read_bytes()
    binary = len(raw) >= 84 and len(raw) == 84 + 50 * int.from_bytes(raw[80:84], "little")
    m = _by_trimesh(raw, 0 if binary else len(raw), "stl")
    m.merge_vertices()
    return m


def _by_trimesh(raw, text, kind, **how):
    """A mesh of bytes, of which so many at first are text in any encoding."""
    stream = BytesIO(raw[:text].translate(ASCII_ALONE) + raw[text:])
    try:
        m = trimesh.load(stream, kind, force="mesh", process=False, **how)
    except Exception as e:  # trimesh's readers raise whatever they stumble over
        raise ValueError(f"is it a whole {kind.upper()}?") from e
    if not isinstance(m, trimesh.Trimesh):
        raise ValueError("it holds no mesh")
    return m


def _read_obj(file):
    """Vertices and faces of an OBJ file, which trimesh would order and split by materials, groups
    and seams, and whose vertices that are counted back from it counts from the file's end."""
    text = file.read_text(encoding="utf-8-sig", errors="replace")
    text = re.sub(r"#.*", "", text).replace("\\\n", " ")
    vertices, polygons = [], {}
    for line in text.splitlines():
        key, *words = line.split() or [""]
        if key == "v":
            if len(words) < 3:
                raise ValueError(f"{line.strip()!r} is no vertex")
            vertices.append([float(word) for word in words[:3]])
            if not np.isfinite(vertices[-1]).all():
                raise ValueError(f"{line.strip()!r} is no vertex")
        elif key == "f":
            corners = [int(word.partition("/")[0]) for word in words]
            corners = [i - 1 if i > 0 else len(vertices) + i if i < 0 else -1 for i in corners]
            if len(corners) < 3 or min(corners) < 0:
                raise ValueError(f"{line.strip()!r} is no face")
            polygons.setdefault(len(corners), []).append(corners)
    return _of_polygons(np.reshape(vertices, (-1, 3)), polygons, first=1)


def _of_polygons(vertices, polygons, first):
    """A mesh of polygons, {number of corners: theirs}; first is the number of a file's first
    vertex."""
    for corners in polygons.values():
        for wrong in (np.min(corners), np.max(corners)):
            if not 0 <= wrong < len(vertices):
                raise ValueError(f"a face refers to vertex {wrong + first} of {len(vertices)}")
    faces = [_fans(vertices, np.array(corners), first) for corners in polygons.values()]
    return trimesh.Trimesh(vertices, np.concatenate([np.empty((0, 3), int), *faces]), process=False)


def _fans(vertices, corners, number):
    """Triangles (n, 3) of polygons (m, corners) of vertices (v, 3), each a fan from its first
    corner from where these do not overlap; number is that of the first vertex."""
    fans, left = [], corners
    for _ in range(corners.shape[1]):
        p = vertices[left]
        area = np.cross(p[:, 1:-1] - p[:, :1], p[:, 2:] - p[:, :1])
        whole = area.sum(axis=1)
        along = np.einsum("mtx,mx->mt", area, whole)
        least = OVERLAP * np.linalg.norm(area, axis=2).sum(axis=1)
        size = np.linalg.norm(whole, axis=1)
        covers = (along >= -least[:, None] * size[:, None]).all(axis=1) & (size >= least)
        of = left[covers]
        first = np.broadcast_to(of[:, :1], of[:, 2:].shape)
        fans.append(np.stack([first, of[:, 1:-1], of[:, 2:]], axis=-1).reshape(-1, 3))
        left = np.roll(left[~covers], -1, axis=1)
    if len(left):
        named = " ".join(str(i + number) for i in left[0])
        raise ValueError(f"the face of vertices {named} is no fan of triangles; export triangles")
    return np.concatenate(fans)


READERS = {"obj": _read_obj, "ply": _read_ply, "stl": _read_stl}


class _Noise(NamedTuple):
    amplitude_k: float
    scale_m: float
    seed: int


def _temperature(data, m, label):
    """K: a number, or (vertices,) from a list or a described field; and that field's _Noise, which
    is still to be added, or None."""
    if not isinstance(data, dict):
        what = f"{label} temperature_k"
        return _numbers(data, len(m.vertices) if isinstance(data, list) else None, what), None
    optional = ("gradient_k_per_m", "variation_k", "scale_m", "seed")
    _keys(data, f"{label} temperature_k", ("mean_k",), optional)
    number = lambda key, default: _numbers(data.get(key, default), None, f"{label} {key}")
    gradient = _numbers(data.get("gradient_k_per_m", [0, 0, 0]), 3, f"{label} gradient_k_per_m")
    scale_m, seed = number("scale_m", 1.0), number("seed", 0)
    if scale_m <= 0 or seed < 0 or seed != int(seed):
        raise InputError(f"scene: {label}: scale_m must be positive and seed an integer >= 0.")
    v, amplitude_k = np.asarray(m.vertices), number("variation_k", 0.0)
    centre = v[np.unique(m.faces)].mean(axis=0)  # a vertex of no face has no temperature
    t = number("mean_k", None) + (v - centre) @ gradient
    return t, _Noise(amplitude_k, scale_m, int(seed)) if amplitude_k else None
