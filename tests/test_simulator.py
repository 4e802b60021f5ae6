"""The path tracer against closed forms of radiative exchange and a naive reference.

Statistical assertions are z-tests: the residual of many independent pixels has mean zero.
Thresholds are |z| < 4.5 unless said, one false alarm in 150,000 per number tested.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import trimesh
from scipy import stats

from physics import InputError, MaterialLibrary
from physics.bands import equidistant_bands
from physics.planck import noise_sigma, planck
from physics.simulator import Camera, Scene, SceneObject, Truth, simulate
from physics.simulator.sensor import FLOOR_K, Bands
from physics.simulator.shade import Shader, shade
from physics.simulator.trace import ESCAPED, Paths, Tracer, roulette
from physics.sky import Atmosphere, sky_radiance

BANDS = np.array([8.5, 10.0, 12.5])
Z = 4.5


def library(**emissivity):
    """name=e or name=(e at 8 um, e at 14 um), and a sky."""
    rows = {k: np.broadcast_to(v, 2) for k, v in {**emissivity, "sky": 0.5}.items()}
    return MaterialLibrary(list(rows), [8.0, 14.0], np.array(list(rows.values())))


def render(scene, lib, size=(12, 16), spp=16, seed=0, wavelength=BANDS, fwhm=None, netd_k=0):
    fwhm = np.zeros(len(wavelength)) if fwhm is None else fwhm
    return simulate(scene, wavelength_um=wavelength, fwhm_um=fwhm, size=size, spp=spp, seed=seed,
                    library=lib, netd_k=netd_k)  # fmt: skip


def quad(corner, a, b):
    """A parallelogram from a corner and two edges."""
    c, a, b = np.array([corner, a, b], float)
    return trimesh.Trimesh([c, c + a, c + a + b, c + b], [[0, 1, 2], [0, 2, 3]], process=False)


def ground(material="soil", t=295.0, half=3000.0, z=0.0):
    plane = quad((-half, -half, z), (2 * half, 0, 0), (0, 2 * half, 0))
    return SceneObject(plane, material, t, False)


def ball(material="paint", t=300.0, radius=1.0, centre=(0, 0, 1.2), subdivisions=5, smooth=True):
    m = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return SceneObject(m.apply_translation(centre), material, t, smooth)


def z_score(residual, axis=None):
    n = residual.size if axis is None else residual.shape[axis]
    return residual.mean(axis) / (residual.std(axis, ddof=1) / np.sqrt(n))


def outdoors(**kw):
    return Scene([ground(**kw), ball()], Camera((4, 3, 2), (0, 0, 1)), Atmosphere())


OUTDOOR = library(soil=(0.95, 0.9), paint=(0.6, 0.8))


# ---------------------------------------------------------------- closed forms


def test_a_scene_may_lie_anywhere():
    """As in coordinates of a map, which 32 bits know to half a metre."""
    lib = library(soil=0.9, paint=0.5)

    def seen(at):
        objects = [ground(half=500.0), ball()]
        moved = [replace(o, mesh=o.mesh.copy().apply_translation(at)) for o in objects]
        camera = Camera(np.add((0, -8, 2), at), np.add((0, 0, 1), at))
        return render(Scene(moved, camera, Atmosphere(288)), lib)

    (here, truth), (there, moved) = seen((0, 0, 0)), seen((5.12e5, 4.6e6, 100.0))
    same = truth.material == moved.material  # the fraction of a step is left
    assert same.mean() > 0.97 and abs((moved.sky_view - truth.sky_view)[same].mean()) < 0.01
    off = (there.radiance - here.radiance)[:, same] / noise_sigma(BANDS, 1.0)[:, None]
    assert np.abs(off.mean(axis=1)).max() < 0.1


def test_distances_are_those_of_the_pixels_middles():
    """A camera 2 m above a plane sees its point straight along a ray 2 / sin(depression) away, and
    no nearer than it is high."""
    scene = Scene([ground()], Camera((0, 0, 2), (0, 5, 2), 90), Atmosphere())
    d = Tracer(scene, OUTDOOR).seen((8, 8))[1]
    assert np.isinf(d[:4]).all()  # the upper half is sky
    down = (np.arange(4) + 0.5) / 4  # tangents of the rows, and of the columns beside
    across = (np.arange(8) - 3.5) / 4
    expected = 2 / down[:, None] * np.sqrt(1 + down[:, None] ** 2 + across**2)
    np.testing.assert_allclose(d[4:], expected, rtol=1e-4)


@pytest.mark.parametrize("t", [300.0, 287.34])
@pytest.mark.parametrize("e", [0.02, 0.6, 1.0])
def test_isothermal_enclosure_glows_as_a_black_body_on_every_path(e, t):
    walls = trimesh.creation.box(extents=(6, 5, 4))
    scene = Scene(
        [SceneObject(walls, "wall", t, False), ball("ball", t, centre=(0, 0, -0.9))],
        Camera((2.4, 2, 1), (0, 0, -1)),
    )
    cube, truth = render(scene, library(wall=(e, 0.5), ball=(0.3, e)), spp=4)
    glow = np.broadcast_to(planck(BANDS, float(np.float32(t)))[:, None, None], cube.radiance.shape)
    np.testing.assert_allclose(cube.radiance, glow, rtol=3e-7)
    np.testing.assert_allclose(truth.texture, glow, rtol=3e-7)
    assert not truth.sky_texture.any() and not truth.sky_view.any()


def test_parallel_grey_plates():
    # A gap of 1 m between plates 400 m wide. Of the light on a plate's centre the sides send
    # 1 / (1 + 200**2) = 2.5e-5, which at the plates' mean radiance is under 0.03 standard errors.
    n = 400.0
    e1, e2, t1, t2 = np.array([0.3, 0.5, 0.8]), np.array([0.6, 0.4, 0.7]), 280.0, 320.0
    lib = MaterialLibrary(["low", "high"], BANDS, [e1, e2])
    low = SceneObject(quad((-n / 2, -n / 2, 0), (n, 0, 0), (0, n, 0)), "low", t1, False)
    high = SceneObject(quad((-n / 2, -n / 2, 1), (n, 0, 0), (0, n, 0)), "high", t2, False)
    tube = trimesh.creation.box(extents=(n, n, 1)).apply_translation((0, 0, 0.5))
    sides = trimesh.Trimesh(tube.vertices, tube.faces[np.abs(tube.face_normals[:, 2]) < 0.5])
    scene = Scene([low, high, SceneObject(sides, "low", 301.0, False)],
                  Camera((0, 0, 0.8), (0.5, 0, 0)))  # fmt: skip
    cube, truth = render(scene, lib, size=(30, 40), spp=16)
    b1, b2 = planck(BANDS, t1), planck(BANDS, t2)
    # J = e B + (1 - e) J' on both plates; X on one is the J of the other.
    j2 = (e2 * b2 + (1 - e2) * e1 * b1) / (1 - (1 - e1) * (1 - e2))
    assert (truth.material == 0).all()
    assert np.abs(z_score(truth.texture.reshape(3, -1) - j2[:, None], axis=1)).max() < Z
    j1 = e1 * b1 + (1 - e1) * j2
    assert np.abs(z_score(cube.radiance.reshape(3, -1) - j1[:, None], axis=1)).max() < Z


def test_grey_sphere_inside_a_grey_sphere():
    r1, r2, t1, t2 = 1.0, 2.0, 320.0, 290.0
    e1, e2 = np.array([0.5, 0.7, 0.9]), np.array([0.4, 0.6, 0.3])
    lib = MaterialLibrary(["inner", "outer"], BANDS, [e1, e2])
    scene = Scene(
        [ball(name, t, r, (0, 0, 0), smooth=False) for name, t, r in
         (("inner", t1, r1), ("outer", t2, r2))],
        Camera((1.9, 0, 0), (0, 0, 0.01), 50),
    )  # fmt: skip
    truth = render(scene, lib, size=(30, 30), spp=16)[1]
    b1, b2, f = planck(BANDS, t1), planck(BANDS, t2), (r1 / r2) ** 2
    # J2 = e2 B2 + (1 - e2) (f J1 + (1 - f) J2),  J1 = e1 B1 + (1 - e1) J2
    j2 = (e2 * b2 + (1 - e2) * f * e1 * b1) / (1 - (1 - e2) * (f * (1 - e1) + 1 - f))
    on = truth.material == 0
    assert on.sum() > 500
    assert np.abs(z_score(truth.texture[:, on] - j2[:, None], axis=1)).max() < Z


def face_on(wall_width, height, distance):
    """fov and size that see a wall, face on, exactly once: pixels then have equal areas."""
    fov = 2 * np.degrees(np.arctan(height / 2 / distance))
    return fov, (int(20 * height), int(20 * wall_width))


def test_net_exchange_between_two_walls_is_symmetric():
    # Light that A emits and B absorbs, per unit of radiance: A_B e_B G_BA = A_A e_A G_AB,
    # with every number of bounces in a box of 1 x 2 x 1.5 m of four materials.
    lib = library(a=0.7, b=0.4, c=0.5, d=0.9)
    x, y, h = 1.0, 2.0, 1.5
    cold, hot = 280.0, 330.0
    walls = {
        "a": quad((-x / 2, -y / 2, -h / 2), (0, y, 0), (0, 0, h)),
        "b": quad((-x / 2, -y / 2, -h / 2), (x, 0, 0), (0, 0, h)),
        "c1": quad((x / 2, -y / 2, -h / 2), (0, y, 0), (0, 0, h)),
        "c2": quad((-x / 2, y / 2, -h / 2), (x, 0, 0), (0, 0, h)),
        "d1": quad((-x / 2, -y / 2, -h / 2), (x, 0, 0), (0, y, 0)),
        "d2": quad((-x / 2, -y / 2, h / 2), (x, 0, 0), (0, y, 0)),
    }

    def exchange(emitter, seen, seed):
        """Mean and standard error over the area of `seen` of the gain G from `emitter`."""
        objects = [
            SceneObject(m, k[0], hot if k == emitter else cold, False) for k, m in walls.items()
        ]
        if seen == "a":
            (fov, size), eye, at = face_on(y, h, 0.9), (0.4, 0, 0), (-0.5, 0, 0)
        else:
            (fov, size), eye, at = face_on(x, h, 1.5), (0, 0.5, 0), (0, -1.0, 0)
        truth = render(Scene(objects, Camera(eye, at, fov)), lib, size, 64, seed)[1]
        assert (truth.material == lib.index(seen)).all()
        b = planck(BANDS, np.array([cold, hot])[:, None])[..., 1]
        gain = (truth.texture[1] - b[0]) / (b[1] - b[0])
        # Neighbouring pixels share no samples, but differ in expectation; this bounds the error.
        return gain.mean(), gain.std() / np.sqrt(gain.size)

    (g_ba, s_ba), (g_ab, s_ab) = exchange("a", "b", 1), exchange("b", "a", 2)
    p, q = x * h * 0.4, y * h * 0.7
    assert 0.05 < g_ba < 0.5
    assert abs(p * g_ba - q * g_ab) < Z * np.hypot(p * s_ba, q * s_ab)


def ground_points(camera, size):
    """(height, width, 3) where the centres of pixels meet the plane z = 0."""
    forward = np.subtract(camera.target, camera.position)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    h, w = size
    i, j = np.mgrid[:h, :w] + 0.5
    half = np.tan(np.radians(camera.fov_deg) / 2)
    d = (
        forward
        + half * ((2 * j - w) / h)[..., None] * right
        + half * (1 - 2 * i / h)[..., None] * up
    )
    return camera.position - d * (camera.position[2] / d[..., 2])[..., None]


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_mirrors_keep_an_isothermal_enclosure_black(share):
    walls = SceneObject(trimesh.creation.box(extents=(6, 5, 4)), "wall", 290.0, False, "", share)
    inside = replace(ball("wall", 290.0), mirror=share)
    scene = Scene([walls, inside], Camera((2, 2, 1), (0, 0, 0.5)))
    cube, _ = render(scene, library(wall=(0.1, 0.7)))
    black = np.broadcast_to(planck(BANDS, 290.0)[:, None, None], cube.radiance.shape)
    np.testing.assert_allclose(cube.radiance, black, rtol=1e-5)


def test_a_mirror_shows_the_sky_where_the_ray_goes():
    """Flat ground, seen 30 degrees from its plane: S = e B + (1 - e) sky at zenith angle 60."""
    floor = replace(ground(t=280.0), mirror=1.0)
    target = (np.cos(np.pi / 6), 0, 2 - np.sin(np.pi / 6))
    scene = Scene([floor], Camera((0, 0, 2), target, fov_deg=1), Atmosphere())
    lib = library(soil=(0.3, 0.6))
    cube, truth = render(scene, lib, size=(3, 3), spp=4)
    e = lib.at(BANDS)[0]
    sky = sky_radiance(BANDS, np.array([0.5]), scene.atmosphere)[0]
    expected = e * planck(BANDS, 280.0) + (1 - e) * sky
    np.testing.assert_allclose(cube.radiance.mean(axis=(1, 2)), expected, rtol=2e-3)
    np.testing.assert_allclose(truth.texture.mean(axis=(1, 2)), sky, rtol=4e-3)


def test_half_a_mirror_is_half_mirror_and_half_lambertian():
    lib, camera = library(soil=(0.2, 0.4)), Camera((0, 0, 2), (3, 0, 0))
    mean = {}
    for share in (0.0, 0.5, 1.0):
        scene = Scene([replace(ground(t=280.0), mirror=share)], camera, Atmosphere())
        mean[share] = render(scene, lib, spp=256, seed=1)[0].radiance
    residual = mean[0.5] - (mean[0.0] + mean[1.0]) / 2
    assert np.abs(z_score(residual.reshape(len(BANDS), -1), axis=1)).max() < Z
    assert np.abs(mean[1.0] - mean[0.0]).mean() > 5 * np.abs(residual).mean()


def test_sky_view_of_the_ground_under_a_sphere():
    # A sphere of radius r at distance d hides (r / d)^2 cos(angle) of a horizontal facet.
    camera, size, centre = Camera((0, -5, 0.8), (0, 0, -0.6), 50), (40, 60), np.array([0, 0, 3.0])
    scene = Scene([ground(), ball(centre=centre)], camera, Atmosphere())
    truth = render(scene, OUTDOOR, size, 144)[1]
    p = ground_points(camera, size)
    d = np.linalg.norm(centre - p, axis=-1)
    expected = 1 - centre[2] / d**3
    on = (truth.material == 0) & (p[..., 1] < 8) & (p[..., 1] > -5)
    residual = (truth.sky_view - expected)[on]
    assert on.sum() > 1000 and expected[on].min() < 0.9
    for part in np.array_split(np.argsort(expected[on]), 5):
        assert abs(z_score(residual[part])) < Z


def test_sky_view_beside_a_long_wall():
    # A wall seen under the elevation a leaves (1 + cos a) / 2; the wall itself sees one half.
    height = 2.0
    wall = SceneObject(quad((-3000, 0, 0), (6000, 0, 0), (0, 0, height)), "paint", 290.0, False)
    camera, size = Camera((0, -6, 1.5), (0, 0, 0.3), 40), (40, 40)
    truth = render(Scene([ground(), wall], camera, Atmosphere()), OUTDOOR, size, 64)[1]
    on = truth.material == 0
    x = -ground_points(camera, size)[..., 1][on]
    residual = truth.sky_view[on] - (1 + x / np.hypot(x, height)) / 2
    for part in np.array_split(np.argsort(x), 4):
        assert abs(z_score(residual[part])) < Z
    # The ground ends at 3 km, 0.5 mrad under the horizon.
    assert abs(z_score(truth.sky_view[truth.material == 1] - 0.5)) < Z


# ---------------------------------------------------------------- directions


def traced(objects, camera, spp=64, size=(20, 30)):
    scene = Scene(objects, camera, Atmosphere())
    q = roulette(OUTDOOR.at(BANDS))
    rng = np.random.default_rng(0)
    return Tracer(scene, OUTDOOR).paths(size, range(size[0] * size[1]), spp, q, q, rng)


def test_first_directions_follow_lamberts_law():
    # They are uniform on the unit disc below them: from the ground P(cos zenith < c) = c^2, and
    # from a wall cos zenith is distributed like one coordinate of the disc, a semicircle.
    def cos_zenith(surface, camera):
        paths = traced([surface], camera, spp=576)
        assert (np.diff(paths.start) == 2).all() and (paths.material[1::2] == ESCAPED).all()
        return paths.value[1::2].astype(float)

    up = cos_zenith(ground(), Camera((0, 0, 2), (0, 1, 0)))
    assert stats.kstest(up**2, "uniform").pvalue > 1e-4
    wall = SceneObject(quad((-50, 0, -50), (100, 0, 0), (0, 0, 100)), "paint", 290.0, False)
    side = cos_zenith(wall, Camera((0, -2, 0), (0, 0, 0)))
    assert stats.kstest(side, stats.semicircular.cdf).pvalue > 1e-4


def test_a_convex_body_never_sees_itself():
    # Interpolated normals lean out over the facets of so coarse a ball by up to 20 degrees.
    paths = traced([ball(subdivisions=1)], Camera((4, 0, 1.2), (0, 0, 1.2), 25))
    first = paths.start[:-1][np.diff(paths.start) > 1]
    assert len(first) > 1000
    assert (paths.material[first] == 1).all() and (paths.material[first + 1] == ESCAPED).all()


def test_what_would_come_from_below_a_facet_comes_from_above():
    """Beside an edge that is rounded normals lean over it, and directions dip below the facet:
    mirrored back they are as rare near the horizon as any."""
    v = [[-1, -1, 0], [0, -1, 0], [0, 1, 0], [-1, 1, 0], [1, -1, -1], [1, 1, -1]]
    ridge = trimesh.Trimesh(v, [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]], process=False)
    paths = traced([SceneObject(ridge, "paint", 290.0)], Camera((-0.4, 0.1, 1), (-0.4, 0, 0), 28))
    first = paths.start[:-1][np.diff(paths.start) > 1]
    cos_zenith = paths.value[first + 1]
    assert len(first) > 1000 and (cos_zenith > 0).all() and (cos_zenith < 1e-3).mean() < 2e-3


# ---------------------------------------------------------------- against a naive tracer


def naive_sphere_scene(camera, size, spp, lib, atmosphere, seed):
    """Eq. 1 by recursion, S = e B + (1 - e) S', for `outdoors()` -> samples (spp, bands, h, w).

    The sphere and the plane are solved for, not meshed; nothing is stratified and nothing ends
    by roulette; after 14 bounces (weight < 0.4^14) the rest is taken as black.
    """
    rng = np.random.default_rng(seed)
    centre, (soil, paint) = np.array([0, 0, 1.2]), lib.at(BANDS)[:2]

    def light(origin, d, depth):
        along = ((origin - centre) * d).sum(1)
        square = along**2 - ((origin - centre) ** 2).sum(1) + 1
        t_ball = np.where(square > 0, -along - np.sqrt(np.maximum(square, 0)), np.inf)
        t_ball[t_ball < 1e-6] = np.inf
        with np.errstate(divide="ignore"):
            t_ground = np.where(d[:, 2] < 0, -origin[:, 2] / d[:, 2], np.inf)
        t_ground[t_ground < 1e-6] = np.inf
        t = np.minimum(t_ball, t_ground)
        s = np.empty((len(d), len(BANDS)))
        s[np.isinf(t)] = sky_radiance(BANDS, d[np.isinf(t), 2], atmosphere)
        for hit, e, kelvin in ((t_ball < t_ground, paint, 300.0), (t_ground < t_ball, soil, 295.0)):
            if not hit.any():
                continue
            p = origin[hit] + t[hit, None] * d[hit]
            n = p - centre if kelvin == 300.0 else np.broadcast_to([0.0, 0, 1], p.shape)
            # normal + uniform point of the unit sphere is cosine distributed
            out = rng.normal(size=p.shape)
            out = n + out / np.linalg.norm(out, axis=1, keepdims=True)
            out /= np.linalg.norm(out, axis=1, keepdims=True)
            incoming = light(p, out, depth + 1) if depth < 14 else 0.0
            s[hit] = e * planck(BANDS, kelvin) + (1 - e) * incoming
        return s

    forward = np.subtract(camera.target, camera.position)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    h, w = size
    i, j = np.mgrid[:h, :w]
    samples = []
    for _ in range(spp):
        y = 1 - 2 * (i + rng.random(size)) / h
        x = (2 * (j + rng.random(size)) - w) / h
        half = np.tan(np.radians(camera.fov_deg) / 2)
        d = forward + half * (x[..., None] * right + y[..., None] * np.cross(right, forward))
        d = (d / np.linalg.norm(d, axis=-1, keepdims=True)).reshape(-1, 3)
        s = light(np.broadcast_to(np.array(camera.position, float), d.shape), d, 0)
        samples.append(s.T.reshape(len(BANDS), h, w))
    return np.array(samples)


@pytest.fixture(scope="module")
def naive():
    scene = outdoors()
    lib = library(soil=(0.7, 0.9), paint=(0.6, 0.8))
    samples = naive_sphere_scene(scene.camera, (12, 16), 250, lib, scene.atmosphere, seed=5)
    return scene, lib, samples.mean(0), samples.std(0, ddof=1) / np.sqrt(len(samples))


def assert_same_image(runs, mean, error):
    """runs (n, bands, h, w): independent renders; every z is about a unit normal."""
    z = (runs.mean(0) - mean) / np.sqrt(runs.var(0, ddof=1) / len(runs) + error**2)
    n = z[0].size
    assert np.abs(z.mean((1, 2))).max() < Z / np.sqrt(n)
    # chi-square with n degrees of freedom, in its normal limit
    assert np.abs(((z**2).sum((1, 2)) - n) / np.sqrt(2 * n)).max() < Z
    assert np.abs(z).max() < 5.5


def test_agrees_with_a_naive_recursive_tracer(naive):
    scene, lib, mean, error = naive
    runs = np.array([render(scene, lib, spp=16, seed=s)[0].radiance for s in range(16)], float)
    assert_same_image(runs, mean, error)


def test_paths_may_be_shaded_with_another_library(naive):
    # Traced with the roulette of a far more emissive library, shaded with the naive one's.
    scene, lib, mean, error = naive
    q = roulette(library(soil=0.95, paint=0.75).at(BANDS))
    tracer, runs = Tracer(scene, lib), []
    at = Bands.of(BANDS, np.zeros(3))
    sky = partial(sky_radiance, atmosphere=scene.atmosphere)
    shader = Shader.build(at, lib.at(BANDS), q, (295.0, 300.0), sky)
    for seed in range(16):
        paths = tracer.paths((12, 16), range(192), 16, q, q, np.random.default_rng(seed))
        runs.append(shade(paths, shader, 16).radiance.T.reshape(3, 12, 16))
    assert_same_image(np.array(runs), mean, error)


# ---------------------------------------------------------------- tables


def one_surface_paths(material, value):
    n = len(value)
    start = np.arange(n + 1)
    return Paths(start, start[1:], np.full(n, material, np.uint16), value.astype(np.float32),
                 np.zeros(n, np.float32), np.ones(1), np.ones(1))  # fmt: skip


def test_tables_of_planck_and_sky_are_finer_than_the_noise():
    w, sky = np.linspace(8, 14, 25), partial(sky_radiance, atmosphere=Atmosphere(water_cm=3.0))
    at = Bands.of(w, np.zeros(25))
    shader = Shader.build(at, np.ones((1, 25)), np.ones(1), (230.0, 340.0), sky)
    t = np.linspace(230, 340, 5001).astype(np.float32)
    got = shade(one_surface_paths(0, t), shader, 1).radiance
    exact = planck(w, t.astype(float)[:, None])
    # the table's error and the rounding of a float32 result
    assert (np.abs(got - exact) < 1e-4 * noise_sigma(w, 0.05) + 2e-7 * exact).all()
    mu = (np.linspace(0, 1, 3001) ** 2).astype(np.float32)
    got = shade(one_surface_paths(ESCAPED, mu), shader, 1).radiance
    assert (np.abs(got - sky(w, mu.astype(float))) / noise_sigma(w, 0.05)).max() < 0.02


# ---------------------------------------------------------------- truth


def test_truth_obeys_equation_1():
    camera = Camera((4, 3, 2), (0, 0, 1.2), 8)  # the ball fills the picture
    scene = Scene([ground(), ball()], camera, Atmosphere())
    cube, truth = render(scene, OUTDOOR)
    e, x = truth.emissivity, truth.texture
    assert (truth.material == 1).all() and (truth.temperature_k == 300).all()
    s = e * planck(BANDS[:, None, None], truth.temperature_k) + (1 - e) * x
    np.testing.assert_allclose(cube.radiance, s, rtol=1e-6)


def test_sky_pixels_obey_equation_1_without_texture():
    scene = Scene([ground()], Camera((0, 0, 2), (0, 5, 4)), Atmosphere(air_temperature_k=285.0))
    cube, truth = render(scene, OUTDOOR)
    sky = truth.material == OUTDOOR.sky_index
    assert sky[0].all() and truth.material_names[OUTDOOR.sky_index] == "sky"
    assert (truth.temperature_k[sky] == 285).all() and (truth.sky_view[sky] == 1).all()
    assert not truth.texture[:, sky].any() and (truth.emissivity[:, sky] <= 1).all()
    glow = planck(BANDS[:, None, None], 285.0)
    np.testing.assert_allclose((truth.emissivity * glow)[:, sky], cube.radiance[:, sky], rtol=1e-6)
    np.testing.assert_allclose(truth.sky_texture[sky], cube.radiance[:, sky].mean(0), rtol=1e-6)


def test_black_surfaces_show_no_texture():
    scene = Scene([ground(), ball()], Camera((4, 3, 2), (0, 0, 1.2), 8), Atmosphere())
    cube = render(scene, library(soil=0.5, paint=1.0))[0]
    glow = np.broadcast_to(planck(BANDS, 300.0)[:, None, None], cube.radiance.shape)
    np.testing.assert_allclose(cube.radiance, glow, rtol=3e-7)


def test_sky_texture_is_the_texture_when_nothing_else_shines():
    warm = render(outdoors(), OUTDOOR)[1]
    on = warm.material < 2
    assert (warm.sky_texture <= warm.texture.mean(0) * (1 + 1e-6))[on].all()
    # At 2 K nothing glows in the infrared.
    dark = Scene([ground(t=2.0), ball(t=2.0)], outdoors().camera, Atmosphere())
    cold = render(dark, OUTDOOR)[1]
    np.testing.assert_allclose(cold.sky_texture[on], cold.texture.mean(0)[on], rtol=1e-5)
    np.testing.assert_allclose(warm.sky_texture, cold.sky_texture, rtol=1e-5)


def test_temperature_varies_within_an_object():
    wall = quad((-2, 0, -2), (4, 0, 0), (0, 0, 4))
    t = 290 + 2.5 * wall.vertices[:, 0]
    room = trimesh.creation.box(extents=(10, 10, 10))
    scene = Scene([SceneObject(wall, "paint", t, False), SceneObject(room, "soil", 280, False)],
                  Camera((0, -2, 0), (0, 0, 0), 60))  # fmt: skip
    truth = render(scene, OUTDOOR, (20, 20), 16)[1]
    pixel = 2 * 2 * np.tan(np.radians(30)) / 20
    expected = 290 + 2.5 * pixel * (np.arange(20) - 9.5)
    # Samples are uniform within the pixel: standard deviation of the mean below w / sqrt(12 n).
    sigma = 2.5 * pixel / np.sqrt(12 * 16)
    assert np.abs(truth.temperature_k - expected).max() < Z * sigma


def test_the_daylight_picture_has_sky_shade_and_albedo():
    lib = OUTDOOR
    scene = Scene([ground(half=30), ball(centre=(0, 0, 3))], Camera((0, -9, 3), (0, 0, 1.5)),
                  Atmosphere(), sun_direction=(0, 0, 1))  # fmt: skip
    visible = render(scene, lib, (40, 60), 16)[1].visible
    assert visible.min() >= 0 and visible.max() <= 1.2
    assert visible[0, 0, 2] > visible[0, 0, 0]  # blue above
    row = visible[:, 30].sum(-1)
    p = ground_points(scene.camera, (40, 60))[:, 30, 1]
    shade_row, lit_row = np.argmin(np.abs(p)), np.argmin(np.abs(p + 3))
    assert row[shade_row] < 0.6 * row[lit_row]


def test_truth_round_trip(tmp_path):
    truth = render(outdoors(), OUTDOOR, spp=2)[1]
    truth.save(tmp_path / "a.truth.npz")
    back = Truth.load(tmp_path / "a.truth.npz")
    assert back.material_names == truth.material_names and back.material.dtype == np.int16
    for key in ("temperature_k", "emissivity", "texture", "sky_view", "sky_texture", "visible"):
        assert getattr(back, key).dtype == np.float32
        np.testing.assert_array_equal(getattr(back, key), getattr(truth, key))
    assert [f.name for f in tmp_path.iterdir()] == ["a.truth.npz"]


def test_a_damaged_or_foreign_truth_is_one_input_error(tmp_path):
    file = tmp_path / "a.truth.npz"
    render(outdoors(), OUTDOOR, (4, 6), spp=2)[1].save(file)
    whole = file.read_bytes()
    # A handle left open would be a ResourceWarning, and warnings are errors here.
    for part in (b"", b"PK nothing", *(whole[: len(whole) * k // 10] for k in range(1, 10))):
        file.write_bytes(part)
        with pytest.raises(InputError, match="not a whole npz file"):
            Truth.load(file)
    flipped = bytearray(whole)
    flipped[len(whole) // 3 : len(whole) // 3 + 40] = bytes(40)
    file.write_bytes(flipped)
    with pytest.raises(InputError, match="truth: "):
        Truth.load(file)
    np.savez(file, temperature_k=np.ones((2, 2)))
    with pytest.raises(InputError, match="lacks material,"):
        Truth.load(file)
    np.save(tmp_path / "a.npy", np.ones(3))
    with pytest.raises(InputError, match="not a whole npz file"):
        Truth.load(tmp_path / "a.npy")
    with pytest.raises(InputError, match="No such file"):
        Truth.load(tmp_path / "nothing.npz")


# ---------------------------------------------------------------- sampling and sensor


def test_noise_of_the_texture_falls_at_least_as_the_root_of_the_samples():
    scene, spp = outdoors(), np.array([4, 16, 64])
    noise = []
    for n in spp:
        a, b = (render(scene, OUTDOOR, (24, 32), n, seed=s)[1] for s in (1, 2))
        on = (a.material < 2) & (a.material == b.material)
        noise.append(np.sqrt(np.mean((a.texture[1] - b.texture[1])[on] ** 2)))
    slope = np.polyfit(np.log(spp), np.log(noise), 1)[0]
    error = np.sqrt(1 / 300) / np.log(spp[-1] / spp[0])  # of three std over 300+ effective pixels
    assert slope < -0.5 + Z * error


def test_same_seed_same_cube_whatever_the_threads(monkeypatch):
    kw = dict(size=(40, 60), spp=64, netd_k=0.05)  # three blocks
    for module in ("traced", "sensor"):
        monkeypatch.setattr(f"physics.simulator.{module}.usual_threads", lambda: 3)
    a, ta = render(outdoors(), OUTDOOR, seed=3, **kw)
    for module in ("traced", "sensor"):
        monkeypatch.setattr(f"physics.simulator.{module}.usual_threads", lambda: 1)
    b, tb = render(outdoors(), OUTDOOR, seed=3, **kw)
    np.testing.assert_array_equal(a.radiance, b.radiance)
    np.testing.assert_array_equal(ta.texture, tb.texture)
    np.testing.assert_array_equal(ta.visible, tb.visible)
    assert (render(outdoors(), OUTDOOR, seed=4, **kw)[0].radiance != a.radiance).any()


@pytest.mark.parametrize("bands, by_centre", [(2, 50), (18, 10), (54, 2)])
def test_bands_are_integrated(bands, by_centre):
    """As if by many narrow ones side by side; the centre alone would be far off in the sky."""
    kw = dict(size=(6, 8), spp=8)
    w, width = equidistant_bands(bands, 8.5, 13.0)
    box, truth = render(outdoors(), OUTDOOR, wavelength=w, fwhm=width, **kw)
    n = int(np.ceil(width[0] / 0.005))
    fine = w[:, None] + width[:, None] * ((np.arange(n) + 0.5) / n - 0.5)
    narrow = render(outdoors(), OUTDOOR, wavelength=fine.ravel(), **kw)[0].radiance
    centre = render(outdoors(), OUTDOOR, wavelength=w, **kw)[0].radiance
    sigma = noise_sigma(w, 0.05)[:, None, None]
    error = np.abs(box.radiance - narrow.reshape(bands, n, 6, 8).mean(1)) / sigma
    sky = truth.material == OUTDOOR.sky_index
    assert error.max() < 0.5 and np.median(error[:, ~sky]) < 0.1
    assert (np.abs(box.radiance - centre) / sigma)[:, sky].max() > by_centre


def test_cells_of_unlike_width_may_share_a_middle():
    centre, width = np.array([10.0, 10.05]), np.array([0.1, 0.0])
    bands = Bands.of(centre, width)
    wide = Bands.of([10.0, 10.0001], [0.4, 0.1])  # cells of 0.1 and 0.025
    for b in (bands, wide):
        np.testing.assert_allclose(b.average(b.in_cells(lambda w: w)), b.wavelength_um)
        square = b.wavelength_um**2 + b.fwhm_um**2 / 12
        np.testing.assert_allclose(b.average(b.in_cells(lambda w: w**2)), square, rtol=1e-5)


def test_sensor_noise_has_the_netd_in_every_band():
    w, f = equidistant_bands(8)
    clean, noisy = (render(outdoors(), OUTDOOR, (24, 32), 4, wavelength=w, fwhm=f, netd_k=n)[0]
                    for n in (0, 0.1))  # fmt: skip
    assert clean.netd_k is None and noisy.netd_k == 0.1
    z = (noisy.radiance - clean.radiance) / noise_sigma(w, 0.1)[:, None, None]
    n = z[0].size
    assert np.abs(z.mean((1, 2))).max() < Z / np.sqrt(n)
    assert np.abs(z.var((1, 2)) - 1).max() < Z * np.sqrt(2 / n)
    assert np.abs(np.corrcoef(z.reshape(8, -1)) - np.eye(8)).max() < 5 / np.sqrt(n)


def test_noise_leaves_a_cold_dry_sky_positive():
    air = Atmosphere(air_temperature_k=260, water_cm=0.2)
    scene = Scene([ground(t=255.0)], Camera((0, 0, 2), (0, 5, 6)), air)
    w, f = equidistant_bands(16)
    clean, noisy = (render(scene, OUTDOOR, (24, 32), 4, wavelength=w, fwhm=f, netd_k=n)[0]
                    for n in (0, 2.0))  # fmt: skip
    floor = planck(w, FLOOR_K).astype(np.float32)[:, None, None]
    clipped = noisy.radiance == floor
    assert clean.radiance.min() > 0 and clipped.any() and (noisy.radiance >= floor).all()
    # What is clipped lay within the noise of the floor; the rest is untouched.
    assert clean.radiance[clipped].max() < 5 * noise_sigma(w, 2.0).max()


def test_equidistant_bands_tile_their_range():
    w, f = equidistant_bands(54)
    np.testing.assert_allclose(w[0] - f[0] / 2, 8.0)
    np.testing.assert_allclose(w[-1] + f[-1] / 2, 14.0)
    np.testing.assert_allclose(np.diff(w), f[:-1])
    for n in (0, 2.5, np.nan):
        with pytest.raises(InputError, match="n >= 1"):
            equidistant_bands(n)


def test_progress_is_told_to_the_end():
    seen = []
    simulate(outdoors(), wavelength_um=BANDS, fwhm_um=np.zeros(3), size=(40, 60), spp=64,
             library=OUTDOOR, progress=lambda *a: seen.append(a))  # fmt: skip
    assert seen == [(i, 3) for i in (1, 2, 3)]


# ---------------------------------------------------------------- bad input


def test_open_room_is_refused():
    walls = trimesh.creation.box(extents=(4, 4, 4))
    shell = trimesh.Trimesh(walls.vertices, walls.faces[walls.face_normals[:, 2] < 0.5])
    scene = Scene([SceneObject(shell, "paint", 300, False)], Camera((1, 1, 0), (0, 0, -1)))
    with pytest.raises(InputError, match="not closed"):
        render(scene, OUTDOOR)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(size=(0, 4)), "height must be a whole number of 1"),
        (dict(spp=0), "spp must be"),
        (dict(spp=2.5), "spp must be a whole number .*, got 2.5"),
        (dict(seed=-1), "seed must be a whole number of 0"),
        (dict(netd_k=-1), "NETD"),
        (dict(wavelength_um=[20.0, 21.0, 22.0]), "reach from 20 to 22 um"),
        (dict(wavelength_um=[9.0, 14.4], fwhm_um=[0.3, 0.3]), "reach from 8.85 to 14.55 um"),
        (dict(fwhm_um=[0.1]), "one width"),
        (dict(library=OUTDOOR.subset(["soil", "sky"])), "no material 'paint'"),
        (dict(library=OUTDOOR.subset(["soil", "paint"])), "no 'sky'"),
    ],
)
def test_bad_input_is_one_sentence(change, message):
    args = dict(wavelength_um=BANDS, fwhm_um=np.zeros(3), size=(4, 6), spp=1, library=OUTDOOR)
    with pytest.raises(InputError, match=message):
        simulate(outdoors(), **{**args, **change})
