"""Objects whose surfaces coincide, so that rounding decides which one a ray meets."""

from dataclasses import replace

import numpy as np

from .trace import Tracer

NEAR = 1e-5  # of the distance
TURN = (5**0.5 - 1) / 2  # golden: objects of neighbouring numbers get far apart


def coincident(scene, library, size):
    """Share of the pixels of a picture, (height, width) of them, of a Scene whose middles see one
    object while another lies in the same place; and the indices of the two for which that is so
    most often, None where it is of none.

    Objects that shrink towards the camera by less than NEAR, each by its own share, look as before;
    but of two in the same place that one comes first which shrinks more. library is a
    MaterialLibrary that holds the scene's materials.
    """
    share = np.arange(len(scene.objects)) * TURN % 1
    one, other = (
        Tracer(_shrunk(scene, 1 - NEAR * x), library).seen(size)[0] for x in (share, 1 - share)
    )
    both = one != other
    if not both.any():
        return 0.0, None
    pairs = np.sort(np.stack([one[both], other[both]]), axis=0)
    pairs, count = np.unique(pairs, axis=1, return_counts=True)
    return float(both.mean()), tuple(pairs[:, count.argmax()].tolist())


def _shrunk(scene, scales):
    eye, objects = np.asarray(scene.camera.position), []
    for o, scale in zip(scene.objects, scales, strict=True):
        m = o.mesh.copy()
        m.vertices = eye + scale * (m.vertices - eye)
        objects.append(replace(o, mesh=m))
    return replace(scene, objects=objects)
