"""A scene is data: triangle meshes with a material and temperatures, a camera, a sky.

Lengths are metres, z points up, temperatures are K. A scene without an atmosphere is
meant to be closed (a room): a ray that leaves it is an error of the scene.
"""

from dataclasses import dataclass, field

import numpy as np
import trimesh

from ..errors import InputError
from ..library import SKY
from ..sky import Atmosphere

MAX_M = 1e9  # from the origin
# from the camera: rays are traced in 32 bits, and leak by a facet's size over half a million
MAX_REACH_M = 2e4


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One object: a mesh, what it is made of and how warm it is.

    mesh           trimesh.Trimesh, vertices in m
    material       name of a library material (never "sky")
    temperature_k  a number, or (vertices,) so that temperature varies within the object
    smooth         True: shading normals interpolated from the vertices; False: facets
    name           for messages
    mirror         share of the reflected light that leaves as from a mirror, 0-1; the rest is
                   Lambertian, as Eq. 1 takes all of it to be
    """

    mesh: trimesh.Trimesh
    material: str
    temperature_k: float | np.ndarray
    smooth: bool = True
    name: str = ""
    mirror: float = 0.0

    def __post_init__(self):
        label = self.name or self.material
        n = len(self.mesh.vertices)
        if n == 0 or len(self.mesh.faces) == 0:
            raise InputError(f"scene: object {label!r} has no triangles.")
        if not (np.abs(self.mesh.vertices) <= MAX_M).all():
            raise InputError(
                f"scene: object {label!r} has vertices that are not finite or lie beyond "
                f"{MAX_M:g} m."
            )
        if self.mesh.faces.min() < 0 or self.mesh.faces.max() >= n:
            raise InputError(f"scene: object {label!r} refers to vertices it does not have.")
        if not 0 <= self.mirror <= 1:
            raise InputError(f"scene: object {label!r} must have mirror 0-1, got {self.mirror}.")
        t = np.asarray(self.temperature_k, dtype=np.float64)
        if t.shape not in ((), (n,)) or not ((t > 1) & (t < 2000)).all():
            reach = f"; it has {t.min():g} to {t.max():g}" if t.size else ""
            raise InputError(
                f"scene: object {label!r} needs one temperature in K (1-2000), "
                f"or one for each of its {n} vertices{reach}."
            )
        t = np.array(np.broadcast_to(t, (n,)))
        t.setflags(write=False)
        object.__setattr__(self, "temperature_k", t)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera: position and target in m, vertical field of view in degrees."""

    position: tuple[float, float, float]
    target: tuple[float, float, float]
    fov_deg: float = 40.0

    def __post_init__(self):
        p, t = np.asarray(self.position, float), np.asarray(self.target, float)
        if p.shape != (3,) or t.shape != (3,) or not np.isfinite([p, t]).all():
            raise InputError("scene: camera position and target must be three finite numbers each.")
        if np.abs([p, t]).max() > MAX_M:
            raise InputError(f"scene: camera position and target must lie within {MAX_M:g} m.")
        forward = t - p
        if np.linalg.norm(np.cross(forward, [0, 0, 1])) < 1e-6 * max(1.0, np.linalg.norm(forward)):
            raise InputError("scene: the camera must not look straight up or down, or at itself.")
        if not 1 <= self.fov_deg <= 150:
            raise InputError(f"scene: camera fov_deg must be 1-150, got {self.fov_deg}.")


@dataclass(frozen=True, eq=False)
class Scene:
    """Objects, camera, atmosphere (None indoors) and the sun of the daylight picture.

    sun_direction  unit vector towards the sun; it lights only the visible picture
    """

    objects: tuple[SceneObject, ...]
    camera: Camera
    atmosphere: Atmosphere | None = None
    sun_direction: tuple[float, float, float] = field(default=(-0.4, -0.5, 0.77))
    name: str = "scene"

    def __post_init__(self):
        object.__setattr__(self, "objects", tuple(self.objects))
        if not self.objects:
            raise InputError("scene: it is empty; give at least one object.")
        if any(o.material == SKY for o in self.objects):
            raise InputError("scene: no object can be made of sky; set the atmosphere instead.")
        for o in self.objects:
            reach = np.abs(o.mesh.vertices - np.asarray(self.camera.position)).max()
            if reach > MAX_REACH_M:
                raise InputError(
                    f"scene: object {o.name or o.material!r} reaches {reach / 1000:.0f} km from "
                    f"the camera; cut it at {MAX_REACH_M / 1000:.0f} km, or give it in m."
                )
        sun = np.asarray(self.sun_direction, float)
        if sun.shape != (3,) or not np.isfinite(sun).all() or not sun.any():
            raise InputError("scene: sun_direction must be three numbers, not all zero.")
        sun = sun / np.abs(sun).max()  # whose square neither overflows nor vanishes
        object.__setattr__(self, "sun_direction", tuple(sun / np.linalg.norm(sun)))
