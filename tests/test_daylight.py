"""Light by day against closed forms: a plane, a furnace, a hollow sphere with a hole.

Albedo is the same in red, green and blue unless said, so that colours are those of the light.
"""

import numpy as np
import pytest
import trimesh

from physics import MaterialLibrary
from physics.simulator import Camera, Scene, SceneObject, simulate, trace_scene
from physics.simulator.daylight import CLEAR_SKY_RGB, SKY_RGB, SUN_RGB, daylight
from physics.sky import Atmosphere

DOWN = (0.0, 0.0, -1.0)  # the sun under ground
Z = 4.5


def library(**albedo):
    names = (*albedo, "sky")
    rgb = np.stack([np.broadcast_to(a, 3) for a in (*albedo.values(), 0.5)])
    e = np.full((len(names), 2), 0.6)  # low, so that heat is scattered often too
    return MaterialLibrary(names, [8.0, 14.0], e, albedo_rgb=rgb)


def plane(half=5.0, z=0.0, material="soil", mirror=0.0):
    v = np.array([(-half, -half, z), (half, -half, z), (half, half, z), (-half, half, z)])
    faces = trimesh.Trimesh(v, [[0, 1, 2], [0, 2, 3]], process=False)
    return SceneObject(faces, material, 290.0, False, mirror=mirror)


def ball(centre=(0, 0, 1.1), material="paint", subdivisions=3):
    m = trimesh.creation.icosphere(subdivisions=subdivisions)
    return SceneObject(m.apply_translation(centre), material, 290.0, False)


def each_path(scene, lib, size=(24, 32), spp=16, seed=0):
    """(paths, 3) light, and which of the paths begin on a surface in the sun, which in the sky."""
    (block,) = trace_scene(scene, size, spp, seed, lib).blocks
    first = block.start[:-1]
    light = daylight(block, lib.subset(scene_materials(scene)).albedo_rgb, 1, False)
    return light, block.sun[first] > 0, block.material[first] == 65535


def scene_materials(scene):
    return list(dict.fromkeys(o.material for o in scene.objects))


def assert_mean(light, expected):
    """The mean over paths (n, 3) is the expected one (3,), a z-test."""
    error = light.std(axis=0, ddof=1) / np.sqrt(len(light))
    assert (np.abs(light.mean(axis=0) - expected) < Z * error).all()


@pytest.mark.parametrize("height", [1.0, 0.4])
@pytest.mark.parametrize("mirror", [0.0, 0.25])
def test_a_plane_sends_back_sun_and_sky_exactly(height, mirror):
    # E cos / pi and the whole hemisphere; what is a mirror shows the sky and not the sun.
    sun = (np.sqrt(1 - height**2), 0, height)
    a = np.array([0.3, 0.5, 0.9])
    scene = Scene([plane(mirror=mirror)], Camera((0, -2, 3), (0, 0, 0), 20), Atmosphere(), sun)
    light, *_ = each_path(scene, library(soil=a))
    expected = a * ((1 - mirror) * height * SUN_RGB + SKY_RGB)
    np.testing.assert_allclose(light, np.broadcast_to(expected, light.shape), rtol=1e-6)


def test_white_things_vanish_in_a_white_furnace():
    # Albedo 1, sky alone: everything is as bright as the sky, hollows too.
    scene = Scene(
        [plane(300), ball(), ball((1.5, 1, 0.9))], Camera((3, -4, 2), (0, 0, 0.8), 40),
        Atmosphere(), DOWN,
    )  # fmt: skip
    light, sun, sky = each_path(scene, library(soil=1.0, paint=1.0))
    assert not sun.any() and (light[sky] == CLEAR_SKY_RGB).all()
    assert_mean(light[~sky], SKY_RGB)


def test_an_integrating_sphere():
    # From everywhere in a sphere a part of it fills its share f of the sphere's area. So through
    # a hole of that share falls the light f L_sky on every spot, and what the sun sends in lights
    # all of the wall alike: H = f L_sky + a E (hole seen from the sun / area) + a (1 - f) H.
    a, shell = np.array([0.5, 0.8, 0.95]), trimesh.creation.icosphere(subdivisions=4)
    hole = shell.triangles_center[:, 2] > np.cos(np.radians(35))
    v, faces = shell.vertices, shell.faces
    area = np.cross(v[faces[:, 1]] - v[faces[:, 0]], v[faces[:, 2]] - v[faces[:, 0]]) / 2
    size = np.linalg.norm(area, axis=1)
    sun = np.array([0.3, 0.0, np.sqrt(1 - 0.09)])
    f, towards_sun = size[hole].sum() / size.sum(), (area[hole] @ sun).sum() / size.sum()
    wall = SceneObject(trimesh.Trimesh(v, faces[~hole], process=False), "paint", 290.0, False)
    scene = Scene([wall], Camera((0.6, 0, 0.1), (-0.5, 0, -0.6), 70), Atmosphere(), tuple(sun))
    light, sunlit, sky = each_path(scene, library(paint=a), spp=64)
    assert not sky.any() and 0.05 < sunlit.mean() < 0.95
    h = (f * SKY_RGB + a * SUN_RGB * towards_sun) / (1 - a * (1 - f))
    shadow = light[~sunlit]
    error = shadow.std(axis=0, ddof=1) / np.sqrt(len(shadow))
    assert error.max() < 0.02  # 5120 facets are a sphere to 0.2 %
    assert (np.abs(shadow.mean(axis=0) - a * h) < Z * error + 0.005 * a * h).all()
    assert (a * h > 2 * a * f * SKY_RGB).all()  # one bounce would be far less


def test_the_roulette_does_not_matter():
    scene = Scene([plane(300), ball()], Camera((3, -4, 2), (0, 0, 0.8), 40), Atmosphere())
    bright = library(soil=0.7, paint=0.6)
    seen = []
    for dark in (bright, library(soil=0.25, paint=0.25)):  # paths weigh up to 1.75 times more
        traced = trace_scene(scene, (24, 32), 64, 1, dark)
        seen.append(traced.shade(bright, np.array([10.0]), np.zeros(1))[1].visible.reshape(-1, 3))
    assert (seen[0] != seen[1]).any()
    assert_mean(seen[0] - seen[1], 0)


def test_heat_knows_nothing_of_daylight():
    cubes = []
    for albedo, sun in ((0.05, (0, 0, 1)), (0.95, (0.6, 0, 0.8))):
        scene = Scene([plane(300), ball()], Camera((3, -4, 2), (0, 0, 0.8), 40), Atmosphere(), sun)
        cubes.append(simulate(
            scene, wavelength_um=[9.0, 11.0], fwhm_um=[0, 0], size=(12, 16), spp=16,
            library=library(soil=albedo, paint=albedo),
        ))  # fmt: skip
    (a, truth), (b, again) = cubes
    np.testing.assert_array_equal(a.radiance, b.radiance)
    np.testing.assert_array_equal(truth.sky_texture, again.sky_texture)
    assert (again.visible.mean(axis=(0, 1)) > 3 * truth.visible.mean(axis=(0, 1))).any()


def test_a_room_is_lit_from_the_camera():
    room = trimesh.creation.box(extents=(4, 4, 4))
    scene = Scene([SceneObject(room, "paint", 290.0, False)], Camera((0, 0, 0), (1, 0, 0), 20))
    _, truth = simulate(
        scene, wavelength_um=[10.0], fwhm_um=[0], size=(9, 9), spp=4, library=library(paint=0.5)
    )
    assert truth.visible[4, 4] == pytest.approx(0.5, rel=1e-3)  # head on
    assert (truth.visible[0, 0] < truth.visible[4, 4]).all()
