"""Preset scenes: they repeat, they are closed where they say so, their texture is relief."""

import functools

import numpy as np
import pytest
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from scipy.spatial import cKDTree
from traced import scene_of

from physics.errors import InputError
from physics.library import MaterialLibrary
from physics.simulator import geometry as g
from physics.simulator.presets import PRESETS, preset
from physics.simulator.presets.patches import patches
from physics.simulator.presets.random_scene import enclosed_scene, random_scene

TRIANGLES = {  # fewest and most that each preset may have
    "forest": (100e3, 500e3), "street": (100e3, 500e3), "patches": (100e3, 500e3),
    "patterned": (100e3, 500e3), "room": (50e3, 500e3), "random": (1e3, 150e3),
    "enclosed": (1e3, 700e3),
}  # fmt: skip


@functools.cache
def rays_of(name, seed=0):
    return Rays(scene_of(name, seed))


class Rays:
    """The scene's triangles in Embree; which object a ray meets, -1 for none."""

    def __init__(self, scene):
        meshes = [o.mesh for o in scene.objects]
        whole = g.join(meshes)
        self.v, self.f = np.asarray(whole.vertices, np.float32), np.asarray(whole.faces, np.int32)
        self.owner = np.repeat(np.arange(len(meshes)), [len(m.faces) for m in meshes])
        self.embree = EmbreeScene()
        self.kept = TriangleMesh(self.embree, self.v, self.f)

    def first(self, origins, directions):
        """(n,) index of the triangle that each ray meets first, -1 for none."""
        return self.embree.run(origins.astype(np.float32), directions.astype(np.float32))

    def objects(self, origins, directions):
        hit = self.first(origins, directions)
        return np.where(hit < 0, -1, self.owner[hit])


def camera_rays(camera, height=60, width=90):
    """Origins and unit directions (height * width, 3) through pixel centres."""
    position = np.array(camera.position)
    forward = np.array(camera.target) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    tan = np.tan(np.radians(camera.fov_deg) / 2)
    y, x = np.mgrid[:height, :width]
    d = (
        forward
        + ((2 * x + 1) / width - 1)[..., None] * tan * width / height * right
        + (1 - (2 * y + 1) / height)[..., None] * tan * np.cross(right, forward)
    ).reshape(-1, 3)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return np.broadcast_to(position, d.shape), d


def shares(name, seed=0):
    """Material (or "sky") -> share of the picture's pixels."""
    scene = scene_of(name, seed)
    hit = rays_of(name, seed).objects(*camera_rays(scene.camera))
    names = ["sky" if k < 0 else scene.objects[k].material for k in hit]
    return {n: names.count(n) / len(names) for n in set(names)}


@pytest.mark.parametrize("name", PRESETS)
def test_builds_within_its_limits(name):
    scene = scene_of(name, 1)
    low, high = TRIANGLES[name]
    assert low <= sum(len(o.mesh.faces) for o in scene.objects) <= high
    starter = MaterialLibrary.starter().names
    assert {o.material for o in scene.objects} <= set(starter) - {"sky"}
    for o in scene.objects:
        assert np.isfinite(o.mesh.vertices).all()
        assert o.temperature_k.min() > 240 and o.temperature_k.max() < 360


@pytest.mark.parametrize("name", PRESETS)
def test_seed_decides_all(name):
    one, same, other = scene_of(name, 0), preset(name, 0), scene_of(name, 1)
    assert len(one.objects) == len(same.objects) and one.camera == same.camera
    for a, b in zip(one.objects, same.objects, strict=True):
        assert a.material == b.material
        np.testing.assert_array_equal(a.mesh.vertices, b.mesh.vertices)
        np.testing.assert_array_equal(a.mesh.faces, b.mesh.faces)
        np.testing.assert_array_equal(a.temperature_k, b.temperature_k)
    assert any(
        a.mesh.vertices.shape != b.mesh.vertices.shape or (a.mesh.vertices != b.mesh.vertices).any()
        for a, b in zip(one.objects, other.objects, strict=False)
    )


def test_unknown_preset_lists_the_names():
    with pytest.raises(
        InputError, match="forest, street, patches, patterned, room, random, enclosed"
    ):
        preset("beach")


@pytest.mark.parametrize("seed", [-1, 1.5])
def test_a_seed_that_is_none_is_one_sentence(seed):
    with pytest.raises(InputError, match=f"whole number of 0 or more, got {seed}"):
        preset("patches", seed)


RANDOM_SEEDS = range(100, 114)


def test_random_scenes_differ_and_use_the_library():
    scenes = [scene_of("random", s) for s in RANDOM_SEEDS]
    assert 1 <= sum(s.atmosphere is None for s in scenes) <= 10
    used = {o.material for s in scenes for o in s.objects}
    assert len(used) > 18 and used <= set(MaterialLibrary.starter().names) - {"sky"}
    assert len({s.camera.target for s in scenes}) == len(scenes)
    for seed in RANDOM_SEEDS:
        triangles = sum(len(o.mesh.faces) for o in scene_of("random", seed).objects)
        assert triangles <= TRIANGLES["random"][1]
        assert max(shares("random", seed).values()) < 0.97  # nothing blocks the whole view


def sky_view(scene, spots=40, rays=400):
    """The sky's share of the light on level ground about the camera, by cosine-weighted rays."""
    r = np.random.default_rng(0)
    at = np.array(scene.camera.position) + np.c_[r.uniform(-2, 2, (spots, 2)), np.zeros(spots)]
    z, turn = np.sqrt(1 - r.random(rays)), r.uniform(0, 2 * np.pi, rays)
    flat = np.sqrt(1 - z**2)
    d = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
    return (Rays(scene).first(np.repeat(at, rays, 0), np.tile(d, (spots, 1))) < 0).mean()


def test_woods_and_streets_leave_less_sky():
    left = {}
    for seed in RANDOM_SEEDS:
        scene, enclosed, same = random_scene(seed), enclosed_scene(seed), enclosed_scene(seed)
        assert enclosed.camera == scene.camera and enclosed.atmosphere == scene.atmosphere
        for a, b in zip(scene.objects, enclosed.objects, strict=False):
            np.testing.assert_array_equal(a.temperature_k, b.temperature_k)
        if scene.atmosphere is None:
            assert len(enclosed.objects) == len(scene.objects)
            continue
        for a, b in zip(enclosed.objects, same.objects, strict=True):
            assert a.material == b.material
            np.testing.assert_array_equal(a.mesh.vertices, b.mesh.vertices)
        assert sum(len(o.mesh.faces) for o in enclosed.objects) < 700e3
        left[seed] = sky_view(enclosed), sky_view(scene)
    assert all(some < all_of_it for some, all_of_it in left.values()), left
    some, all_of_it = np.array([*left.values()]).T
    assert (some < 0.75).mean() > 0.5 and (all_of_it > 0.85).all(), left


def closed_random_scene():
    return next(s for s in RANDOM_SEEDS if scene_of("random", s).atmosphere is None)


@pytest.mark.parametrize("name", ["room", "random"])
def test_indoors_is_closed(name):
    seed = 0 if name == "room" else closed_random_scene()
    scene, rays, rng = scene_of(name, seed), rays_of(name, seed), np.random.default_rng(1)
    assert scene.atmosphere is None
    d = rng.normal(size=(200_000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    eye = np.broadcast_to(scene.camera.position, d.shape)
    hit = rays.first(eye, d)
    assert (hit >= 0).all()
    # Onwards from where they landed, just off the surface: a bounce never escapes either.
    triangle = rays.v[rays.f[hit]].astype(float)
    normal = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-30
    normal *= -np.sign((normal * d).sum(1, keepdims=True))
    weight = rng.dirichlet([1, 1, 1], len(d))
    point = (triangle * weight[..., None]).sum(1) + 1e-4 * normal
    bounce = rng.normal(size=d.shape)
    bounce *= np.sign((bounce * normal).sum(1, keepdims=True))
    assert (rays.first(point, bounce) >= 0).all()


@pytest.mark.parametrize("name", ["forest", "street", "patches", "patterned"])
def test_ground_catches_downward_rays(name):
    scene = scene_of(name)
    rng = np.random.default_rng(2)
    d = rng.normal(size=(50_000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    d = d[d[:, 2] < -0.02]
    rays = rays_of(name)
    eye = np.broadcast_to(scene.camera.position, d.shape)
    assert (rays.first(eye, d) >= 0).all()


def test_patches_differ_only_between_each_other():
    scene = scene_of("patches")
    assert sorted(o.material for o in scene.objects) == ["grass", "sand", "snow"]
    for o in scene.objects:
        assert np.ptp(o.temperature_k) == 0
    filled = shares("patches")
    assert min(filled[m] for m in ("snow", "grass", "sand")) > 0.2


def test_finer_patches_are_the_same_surfaces():
    coarse, fine = patches(3), patches(3, fineness=2)
    for a, b in zip(coarse.objects, fine.objects, strict=True):
        assert len(b.mesh.faces) > len(a.mesh.faces)
        off, _ = cKDTree(b.mesh.vertices).query(a.mesh.vertices)
        assert off.max() < 1e-9, a.name


def test_patterned_temperature_ignores_the_relief():
    scene = scene_of("patterned")
    for o in scene.objects:
        assert np.ptp(o.temperature_k) > 5
        # Beyond 25 m from the camera the ground's triangles are larger than its pattern.
        near = np.hypot(*o.mesh.vertices[:, :2].T) < 25
        t = o.temperature_k[near]
        relief = np.c_[o.mesh.vertices[near, 2], g.normals(o.mesh)[near]]
        for column in relief.T:
            if np.ptp(column) > 1e-9:
                assert abs(np.corrcoef(t, column)[0, 1]) < 0.2, (o.name, o.material)
    assert 0.08 < shares("patterned")["sky"] < 0.22


@pytest.mark.parametrize("seed", [0, 1])
def test_forest_shows_all_its_materials(seed):
    filled = shares("forest", seed)
    assert set(filled) == {"bark", "foliage", "granite", "water", "soil", "grass", "sky"}
    assert min(filled.values()) >= 0.04
    assert 0.13 < filled["sky"] < 0.27


def test_forest_sky_reaches_well_above_the_horizon():
    scene = scene_of("forest")
    origin, d = camera_rays(scene.camera)
    sky = rays_of("forest").objects(origin, d) < 0
    assert (sky & (d[:, 2] > np.sin(np.radians(15)))).mean() > 0.03


def test_street_shows_its_things():
    filled = shares("street")
    for material in ("asphalt", "brick", "plaster", "concrete", "glass", "sky"):
        assert filled[material] > 0.03, material
    for material in ("steel", "rubber", "fabric", "foliage"):
        assert filled[material] > 0.002, material


def test_noise_is_smooth_zero_mean_and_of_unit_size():
    p = np.random.default_rng(0).uniform(-40, 40, (40_000, 3))
    n = g.value_noise(p, 0.8, seed=5)
    assert abs(n.mean()) < 0.02 and 0.2 < n.std() < 0.6 and 0.8 < np.abs(n).max() <= 1
    step = 1e-4
    slope = (g.value_noise(p + [step, 0, 0], 0.8, seed=5) - n) / step
    assert np.abs(slope).max() < 2 * 1.875 / 0.8 * 3  # quintic's steepest slope, every axis
    assert not np.array_equal(n, g.value_noise(p, 0.8, seed=6))


@pytest.mark.parametrize(
    "m",
    [g.rock(3, subdivisions=3), g.sphere(2), g.tube([[0, 0, 0], [0, 0, 1], [0.2, 0, 2]], [1, 1, 1]),
     g.lathe([[0, 0], [1, 0.2], [0, 1]], 24)],
)  # fmt: skip
def test_solids_face_outwards(m):
    assert m.volume > 0


def test_slab_is_shut_and_faces_outwards():
    m = g.slab((1, 2, 0.5), 0.1, lambda v: 0.02 * g.value_noise(v, 0.3, 1))
    m.merge_vertices()
    assert m.is_watertight
    assert m.volume == pytest.approx(1.0, rel=0.05)


def test_leaves_and_grass_are_separate_polygons():
    rng = np.random.default_rng(0)
    leaf = g.leaves(np.zeros((3, 3)), 0.2, 10, 0.1, rng)
    assert leaf.faces.shape == (60, 3) and leaf.vertices.shape == (120, 3)
    blade = g.grass(np.zeros((5, 3)), 0.2, rng)
    assert blade.faces.shape == (15, 3) and blade.vertices[:, 2].max() < 0.3
