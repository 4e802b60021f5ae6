"""Path-traced heat cubes with their truth. The map:

scene       Scene, SceneObject, Camera: what there is
scene_file  a scene from a JSON file
geometry    meshes with relief
refined     triangles made smaller where they must
presets     ready-made scenes
trace       light paths, traced once for all bands
coincident  objects that lie in one another
shade       the estimator: paths become radiance and truth
daylight    the visible picture from the same paths
sensor      bands of finite width, and noise
traced      TracedScene: the paths of a scene kept, to be shaded again
simulate    all of it together
"""

from ..truth import Truth
from .scene import Camera, Scene, SceneObject
from .scene_file import load_scene
from .simulate import simulate
from .traced import TracedScene, trace_scene

__all__ = [
    "Camera", "Scene", "SceneObject", "TracedScene", "Truth", "load_scene", "presets", "simulate",
    "trace_scene",
]  # fmt: skip
