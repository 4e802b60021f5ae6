"""Light paths: traced once, without a wavelength; any library shades them later.

Geometry does not depend on wavelength, and Lambertian surfaces scatter alike in every
band. So a path is only the list of surfaces that light would come from: surface 0, which
the camera sees; surface 1, whose light falls on surface 0; and so on, until Russian
roulette ends it or it leaves for the sky. `shade` says how a path becomes radiance.

    surface 0 -> 1       always traced: this bounce carries the texture X
    surface i -> i + 1   with probability q_i, one fixed number per material, stored with
                         the paths so that another library may shade them without bias

By day more is scattered than in the infrared, and light of many bounces counts. So where the
roulette of heat ends a path, it goes on for the daylight picture alone, with a q of its own. Its
random numbers are its own as well: heat does not depend on it.

Directions are cosine weighted about the shading normal; where a surface has a share that is
a mirror, so large a share of them are the mirror's. A direction that would dip under the
facet is mirrored back above it. Over the samples of one pixel the first direction is
stratified; its strata are shuffled against those of the camera jitter.
"""

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from ..errors import InputError
from ..machinery.compiled import compiled
from .geometry import normals

ENDS, DAY, HEAT = 0, 1, 2  # how a path goes on: not, for daylight alone, for heat and daylight
ESCAPED = 65535  # stands in Paths.material where a ray leaves for the sky
ORIGIN_STEP_M = 16.0
LEAK_FRACTION = 1e-4  # float32 lets a few bounces slip through the corners of a closed room


@dataclass(frozen=True, eq=False)
class Paths:
    """Light paths, compactly; path p is rows start[p]:start[p + 1] of the vertex arrays.

    start     (paths + 1,) int64; the samples of one pixel follow each other
    end       (paths,) int64; rows from end[p] on are of daylight alone
    material  (vertices,) uint16 library index, or ESCAPED
    value     (vertices,) float32 temperature in K; for ESCAPED the cosine of the zenith angle
    sun       (vertices,) float32 share of the sun's light that a surface there scatters, but for
              its albedo: the cosine between normal and sun times the share that is no mirror, 0
              in shadow; without an atmosphere the cosine towards the camera, for surface 0 alone
    roulette  (materials,) q, the probability to go on after such a surface
    day_roulette  (materials,) the same of daylight, at least q
    """

    start: np.ndarray
    end: np.ndarray
    material: np.ndarray
    value: np.ndarray
    sun: np.ndarray
    roulette: np.ndarray
    day_roulette: np.ndarray


def roulette(emissivity):
    """(materials,) q for an (materials, n) emissivity: the largest reflectance.

    With q = max(1 - e) no weight (1 - e) / q exceeds 1, so single paths stay tame. At least
    0.05 of the paths go on; at most 0.99, so that paths between perfect mirrors end.
    """
    return np.clip((1 - emissivity).max(axis=1), 0.05, 0.99)


class Tracer:
    """A scene made ready for ray queries; may be shared between threads.

    scene    Scene
    library  MaterialLibrary that holds the scene's materials (else InputError)
    """

    def __init__(self, scene, library):
        self.scene = scene
        # in 32 bits what lies far from the origin has no fine shape; near it nothing changes
        origin = ORIGIN_STEP_M * np.round(np.divide(scene.camera.position, ORIGIN_STEP_M))
        self.eye = np.subtract(scene.camera.position, origin).astype(np.float32)
        corners, corner_normals, temperatures, materials, mirror, of = [], [], [], [], [], []
        for i, o in enumerate(scene.objects):
            faces = np.asarray(o.mesh.faces)
            v = (np.asarray(o.mesh.vertices) - origin).astype(np.float32)
            # A normal of zero means: take the facet's.
            n = normals(o.mesh) if o.smooth else np.zeros(v.shape)
            corners.append(v[faces])
            corner_normals.append(n.astype(np.float32)[faces])
            temperatures.append(o.temperature_k.astype(np.float32)[faces])
            materials.append(np.full(len(faces), library.index(o.material), np.uint16))
            mirror.append(np.full(len(faces), o.mirror, np.float32))
            of.append(np.full(len(faces), i))
        self.corners = np.concatenate(corners)
        self.corner_normals = np.concatenate(corner_normals)
        self.temperature_k = np.concatenate(temperatures)
        self.material = np.concatenate(materials)
        self.mirror = np.concatenate(mirror)
        self.object = np.concatenate(of)
        # Embree's rounding grows with the coordinates of a facet; 16 float32 steps clear it.
        self.lift = 2.0**-19 * np.abs(self.corners).max(axis=(1, 2)) + 1e-7
        self._embree = EmbreeScene(robust=True)
        TriangleMesh(self._embree, self.corners)
        self._embree.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))  # builds it

    def paths(self, size, pixels, spp, q, q_day, rng):
        """Trace spp paths through each pixel of a range of row-major pixels -> Paths.

        size (height, width); pixels a `range`; q and q_day (materials,) as from `roulette`, the
        second at least the first; rng a numpy Generator.
        Raises InputError where rays leave a scene without atmosphere.
        """
        closed = self.scene.atmosphere is None
        n = len(pixels) * spp
        jitter = _stratified(len(pixels), spp, rng, shuffled=False)
        direction = _camera_rays(pixels.start, spp, *size, _camera_frame(self.scene.camera), jitter)
        origin = np.broadcast_to(self.eye, (n, 3)).copy()
        xi = np.zeros((n, 3), np.float32)  # third column 0: the first bounce is always traced
        xi[:, :2] = _stratified(len(pixels), spp, rng, shuffled=True)
        path = np.arange(n, dtype=np.int32)
        hot, day_rng = n, rng.spawn(1)[0]  # the first `hot` rays are of heat and daylight
        depths, bounces, leaks = [], 0, 0
        while len(path):
            hit = self._embree.run(origin, direction, query="INTERSECT", output=True)
            if closed:
                missed = np.count_nonzero(hit["primID"] < 0)
                bounces, leaks = bounces + len(path), leaks + missed
                if leaks > max(1, LEAK_FRACTION * bounces) or (missed and not depths):
                    raise InputError(
                        f"scene: {self.scene.name!r} has no atmosphere and is not closed: rays "
                        "leave it; close the room or set an atmosphere."
                    )
            material = np.empty(len(path), np.uint16)
            value, sun = np.zeros((2, len(path)), np.float32)
            surface, goes_on, origin, direction, normal = _bounce(
                hit["primID"], hit["u"], hit["v"], direction, xi, q, q_day, hot,
                self.corners, self.corner_normals, self.temperature_k, self.material, self.mirror,
                self.lift, material, value,
            )  # fmt: skip
            if not closed:
                diffuse = 1 - self.mirror[hit["primID"][surface]]
                sun[surface] = diffuse * self._sunlight(origin, normal)
            elif not depths:
                to_eye = self.eye - origin
                sun[surface] = np.abs((normal * to_eye).sum(1)) / np.linalg.norm(to_eye, axis=1)
            depths.append((path, material, value, sun, np.arange(len(path)) < hot))
            on = np.concatenate([np.flatnonzero(goes_on == of) for of in (HEAT, DAY)])
            path, origin, direction = path[surface[on]], origin[on], direction[on]
            hot = np.count_nonzero(goes_on == HEAT)
            xi = np.empty((len(path), 3), np.float32)
            rng.random(dtype=np.float32, out=xi[:hot])
            day_rng.random(dtype=np.float32, out=xi[hot:])
        return Paths(*_pack(n, depths, closed), q, q_day)

    def seen(self, size):
        """(height, width) index of the object that the pixels' middles see, -1 of the sky; and how
        far away it is, m, infinite of the sky."""
        direction = view_directions(self.scene.camera, size)
        origin = np.broadcast_to(self.eye, direction.shape).copy()
        hit = self._embree.run(origin, direction, query="INTERSECT", output=True)
        is_sky = hit["primID"] < 0
        which = np.where(is_sky, -1, self.object[hit["primID"]])
        return which.reshape(size), np.where(is_sky, np.inf, hit["tfar"]).reshape(size)

    def _sunlight(self, point, normal):
        """(n,) cosine between the sun and the normals (n, 3) at points (n, 3), 0 in shadow."""
        towards_sun = np.asarray(self.scene.sun_direction, np.float32)
        cosine = np.maximum(normal @ towards_sun, 0)
        lit = np.flatnonzero(cosine > 0)
        if len(lit):
            towards = np.broadcast_to(towards_sun, (len(lit), 3)).copy()
            blocked = self._embree.run(point[lit], towards, query="OCCLUDED") >= 0
            cosine[lit[blocked]] = 0
        return cosine


def view_directions(camera, size):
    """(height * width, 3) float32 unit vectors in which the pixels' middles look."""
    middle = np.full((size[0] * size[1], 2), 0.5, np.float32)
    return _camera_rays(0, 1, *size, _camera_frame(camera), middle)


def _stratified(pixels, spp, rng, shuffled):
    """(pixels * spp, 2) random points in the unit square, one per cell for each pixel.

    The cells are the most nearly square grid with spp cells (a row of them if spp is prime).
    """
    rows = next(k for k in range(int(np.sqrt(spp)), 0, -1) if spp % k == 0)
    columns = spp // rows
    cell = np.broadcast_to(np.arange(spp), (pixels, spp))
    if shuffled:
        cell = rng.permuted(cell, axis=1)
    corner = np.stack([cell // columns, cell % columns], axis=-1).reshape(-1, 2)
    xi = (corner + rng.random((pixels * spp, 2))) / (rows, columns)
    # Rounding to float32 must not reach 1, which is the next cell.
    return np.minimum(xi.astype(np.float32), np.float32(1 - 2**-24))


def _camera_frame(camera):
    """(3, 3) float64 rows: right and up, scaled to half the image height, and forward."""
    forward = np.subtract(camera.target, camera.position)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    half = np.tan(np.radians(camera.fov_deg) / 2)
    return np.stack([half * right, half * np.cross(right, forward), forward])


@compiled(nogil=True)
def _camera_rays(first_pixel, spp, height, width, frame, jitter):
    """(n, 3) float32 unit directions through jittered points of the pixels."""
    direction = np.empty((len(jitter), 3), np.float32)
    for s in range(len(jitter)):
        row, column = divmod(first_pixel + s // spp, width)
        x = (2 * (column + jitter[s, 0]) - width) / height
        y = 1 - 2 * (row + jitter[s, 1]) / height
        d0 = frame[2, 0] + x * frame[0, 0] + y * frame[1, 0]
        d1 = frame[2, 1] + x * frame[0, 1] + y * frame[1, 1]
        d2 = frame[2, 2] + x * frame[0, 2] + y * frame[1, 2]
        scale = 1 / np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
        direction[s, 0] = d0 * scale
        direction[s, 1] = d1 * scale
        direction[s, 2] = d2 * scale
    return direction


@compiled(nogil=True)
def _mix(corner, b0, b1, b2, k):
    """Component k of the three rows of corner (3, 3), weighted by barycentric coordinates."""
    return b0 * corner[0, k] + b1 * corner[1, k] + b2 * corner[2, k]


@compiled(nogil=True)
def _bounce(
    facet, u, v, incoming, xi, q, q_day, hot, corners, corner_normals, temperature, material_of,
    mirror, lift, material, value,
):  # fmt: skip
    """Say what the rays hit and send on those that go on.

    Fills material and value (rays,) as in Paths. Returns of the rays that hit a surface the
    index, how they go on, where from, where to (if they do) and the shading normal.
    """
    n = len(facet)
    surface, goes_on = np.empty(n, np.int32), np.empty(n, np.uint8)
    origin = np.empty((n, 3), np.float32)
    direction = np.empty((n, 3), np.float32)
    normal = np.empty((n, 3), np.float32)
    count = 0
    for r in range(n):
        f = facet[r]
        if f < 0:
            material[r] = ESCAPED
            value[r] = incoming[r, 2]
            continue
        m = material_of[f]
        b1, b2 = u[r], v[r]
        t0 = temperature[f, 0]
        material[r] = m
        value[r] = t0 + b1 * (temperature[f, 1] - t0) + b2 * (temperature[f, 2] - t0)

        # Facet normal g, turned towards where the ray came from.
        e1 = corners[f, 1] - corners[f, 0]
        e2 = corners[f, 2] - corners[f, 0]
        g0 = np.float64(e1[1]) * e2[2] - np.float64(e1[2]) * e2[1]
        g1 = np.float64(e1[2]) * e2[0] - np.float64(e1[0]) * e2[2]
        g2 = np.float64(e1[0]) * e2[1] - np.float64(e1[1]) * e2[0]
        turn = 1 / max(np.sqrt(g0 * g0 + g1 * g1 + g2 * g2), 1e-300)
        if g0 * incoming[r, 0] + g1 * incoming[r, 1] + g2 * incoming[r, 2] > 0:
            turn = -turn
        g0, g1, g2 = g0 * turn, g1 * turn, g2 * turn

        # Shading normal s, on the same side of the facet.
        b0 = np.float64(1) - b1 - b2
        s0 = _mix(corner_normals[f], b0, b1, b2, 0)
        s1 = _mix(corner_normals[f], b0, b1, b2, 1)
        s2 = _mix(corner_normals[f], b0, b1, b2, 2)
        length = np.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
        if length < 1e-6:
            s0, s1, s2 = g0, g1, g2
        else:
            turn = 1 / length
            if s0 * g0 + s1 * g1 + s2 * g2 < 0:
                turn = -turn
            s0, s1, s2 = s0 * turn, s1 * turn, s2 * turn

        surface[count] = r
        goes_on[count] = ENDS
        if xi[r, 2] < q_day[m]:
            goes_on[count] = HEAT if r < hot and xi[r, 2] < q[m] else DAY
        origin[count, 0] = _mix(corners[f], b0, b1, b2, 0) + lift[f] * g0
        origin[count, 1] = _mix(corners[f], b0, b1, b2, 1) + lift[f] * g1
        origin[count, 2] = _mix(corners[f], b0, b1, b2, 2) + lift[f] * g2
        normal[count, 0], normal[count, 1], normal[count, 2] = s0, s1, s2
        count += 1
        if goes_on[count - 1] == ENDS:
            continue

        share = np.float64(mirror[f])
        if xi[r, 0] < share:
            d0, d1, d2 = incoming[r, 0], incoming[r, 1], incoming[r, 2]
            into = -2 * (d0 * s0 + d1 * s1 + d2 * s2)
            d0, d1, d2 = d0 + into * s0, d1 + into * s1, d2 + into * s2
        else:
            # Cosine-weighted direction d about s (orthonormal frame: Duff et al. 2017).
            sign = 1.0 if s2 >= 0 else -1.0
            a = -1 / (sign + s2)
            b = s0 * s1 * a
            xi0 = (xi[r, 0] - share) / (1 - share)
            radius = np.sqrt(np.float32(xi0))
            phi = 2 * np.pi * xi[r, 1]
            x, y, z = radius * np.cos(phi), radius * np.sin(phi), np.sqrt(1 - xi0)
            d0 = x * (1 + sign * s0 * s0 * a) + y * b + z * s0
            d1 = x * sign * b + y * (sign + s1 * s1 * a) + z * s1
            d2 = -x * sign * s0 - y * s1 + z * s2
        below = d0 * g0 + d1 * g1 + d2 * g2
        if below < 0:
            d0, d1, d2 = d0 - 2 * below * g0, d1 - 2 * below * g1, d2 - 2 * below * g2
        direction[count - 1, 0], direction[count - 1, 1], direction[count - 1, 2] = d0, d1, d2
    return surface[:count], goes_on[:count], origin[:count], direction[:count], normal[:count]


def _pack(n, depths, closed):
    """Vertices gathered depth by depth -> start, end, material, value, sun of n paths.

    In a closed scene a ray that slipped out is dropped, so that its path ends before it.
    """
    length, of_heat = np.zeros(n + 1, np.int64), np.zeros(n, np.int64)
    if closed:
        depths = [tuple(a[d[1] != ESCAPED] for a in d) for d in depths]
    for path, *_, hot in depths:
        length[path + 1] += 1
        of_heat[path[hot]] += 1
    start = np.cumsum(length)
    material = np.empty(start[-1], np.uint16)
    value, sun = np.empty((2, start[-1]), np.float32)
    for depth, (path, m, t, cosine, _) in enumerate(depths):
        at = start[path] + depth
        material[at], value[at], sun[at] = m, t, cosine
    return start, start[:-1] + of_heat, material, value, sun
