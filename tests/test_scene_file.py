"""Scene files: what they describe is what is built, and every mistake is one sentence."""

import copy
import json

import numpy as np
import pytest
import trimesh

from physics import InputError, MaterialLibrary
from physics.simulator import load_scene
from physics.simulator.geometry import normals, value_noise
from physics.simulator.refined import refined
from physics.simulator.trace import Tracer
from physics.sky import usual_atmosphere
from texnet.files.band_file import read_bands

ROCK = {
    "name": "rock", "mesh": "rock.obj", "material": "granite", "temperature_k": 290,
    "translate": [1, 2, 3], "scale": 2, "rotate_z_deg": 90,
}  # fmt: skip
SCENE = {
    "camera": {"position": [0, -5, 2], "target": [0, 0, 1], "fov_deg": 35},
    "atmosphere": {"air_temperature_k": 280, "water_cm": 2.0},
    "sun_direction": [0, 0, 2],
    "objects": [ROCK],
}


@pytest.fixture
def write(tmp_path):
    tetrahedron = trimesh.Trimesh(
        [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]], [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]
    )
    for suffix in ("obj", "ply", "stl"):
        tetrahedron.export(tmp_path / f"rock.{suffix}")

    def write(change=lambda data: None):
        data = copy.deepcopy(SCENE)
        change(data)
        (tmp_path / "scene.json").write_text(json.dumps(data))
        return tmp_path / "scene.json"

    return write


def with_object(**changes):
    return lambda data: data["objects"][0].update(changes)


def test_a_scene_is_what_its_file_says(write):
    scene = load_scene(write())
    (rock,) = scene.objects
    assert (rock.name, rock.material, rock.smooth, scene.name) == ("rock", "granite", True, "scene")
    assert (rock.temperature_k == 290).all()
    # (1, 0, 0) scaled by 2, turned by 90 degrees about z, moved
    assert np.isclose(rock.mesh.vertices, [1, 4, 3]).all(axis=1).any()
    assert scene.camera.fov_deg == 35 and scene.camera.position == (0, -5, 2)
    assert scene.atmosphere.air_temperature_k == 280 and scene.atmosphere.water_cm == 2
    assert scene.sun_direction == (0, 0, 1)
    for long in (1e300, 1e-300):
        to = load_scene(write(lambda d, n=long: d.update(sun_direction=[n, 0, n]))).sun_direction
        assert to == pytest.approx((0.5**0.5, 0, 0.5**0.5))
    assert load_scene(write(lambda d: d.pop("atmosphere"))).atmosphere is None
    assert load_scene(write(lambda d: d["camera"].pop("fov_deg"))).camera.fov_deg == 40


@pytest.mark.parametrize("kelvin", [230, 255, 300])
def test_cold_air_holds_little_water_if_no_other_is_said(write, kelvin):
    air = load_scene(write(lambda d: d.update(atmosphere={"air_temperature_k": kelvin}))).atmosphere
    saturated = usual_atmosphere(kelvin, 1.0).water_cm
    assert air.air_temperature_k == kelvin and air.water_cm == pytest.approx(saturated / 2)
    with pytest.raises(InputError, match="220-330"):
        load_scene(write(lambda d: d.update(atmosphere={"air_temperature_k": kelvin - 200})))


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
def test_mesh_formats(write, suffix):
    mesh = load_scene(write(with_object(mesh=f"rock.{suffix}", scale=1))).objects[0].mesh
    assert np.isclose(mesh.volume, 1 / 6)


@pytest.mark.parametrize(
    ("mesh", "area", "smooth"),
    [
        ({"shape": "box", "size": [1, 2, 3]}, 22.0, False),
        ({"shape": "plane", "size": [4, 5]}, 20.0, False),
        ({"shape": "sphere", "radius": 2}, 16 * np.pi, True),
        ({"shape": "cylinder", "radius": 1, "height": 3}, 8 * np.pi, False),
    ],
)
def test_shapes(write, mesh, area, smooth):
    built = load_scene(write(with_object(mesh=mesh, scale=1))).objects[0]
    assert built.smooth is smooth and np.isclose(built.mesh.area, area, rtol=5e-3)


def test_temperature_fields(write):
    per_vertex = [280, 281, 282, 283]
    rock = load_scene(write(with_object(temperature_k=per_vertex, smooth=False))).objects[0]
    assert (rock.temperature_k == per_vertex).all()
    field = {
        "mean_k": 290,
        "gradient_k_per_m": [0, 0, 2],
        "variation_k": 1,
        "scale_m": 0.5,
        "seed": 3,
    }
    rock = load_scene(write(with_object(temperature_k=field))).objects[0]
    z = rock.mesh.vertices[:, 2]
    rest = rock.temperature_k - 290 - 2 * (z - z.mean())
    assert 0 < np.abs(rest).max() <= 1
    again = load_scene(write(with_object(temperature_k=field))).objects[0]
    np.testing.assert_array_equal(rock.temperature_k, again.temperature_k)


@pytest.mark.parametrize("shape, size", [("plane", [20, 20]), ("plane", [10000, 10000]),
                                         ("box", [20, 20, 2]), ("cylinder", None)])  # fmt: skip
def test_noise_of_temperature_varies_within_a_large_shape(write, shape, size):
    """As everywhere in space, on the ground within six metres."""
    mesh = {"shape": shape, "size": size} if size else {"shape": shape, "radius": 10, "height": 2}
    field = {"mean_k": 290, "gradient_k_per_m": [1e-3, 0, 0], "variation_k": 2, "scale_m": 1}
    below = [0, 0, 0 if shape == "plane" else -1]
    change = with_object(mesh=mesh, temperature_k=field, translate=below, scale=1)
    ground = load_scene(write(change)).objects[0]
    corners = ground.mesh.vertices[ground.mesh.faces]
    near = (np.abs(corners) < [6, 6, 1e-9]).all(axis=(1, 2))
    assert near.sum() > 1000
    weight = np.random.default_rng(0).dirichlet(np.ones(3), near.sum())
    at = np.einsum("fc,fcx->fx", weight, corners[near])
    t = np.einsum("fc,fc->f", weight, ground.temperature_k[ground.mesh.faces[near]])
    noise = t - 290 - 1e-3 * at[:, 0]
    assert noise.std() > 0.5
    assert np.sqrt(((noise - 2 * value_noise(at, 1.0, 0)) ** 2).mean()) < 0.1


@pytest.mark.parametrize("at", [[0, 0, 0], [500, -300, 0], [777, 70000, 90]])
def test_light_is_taken_close_above_a_wide_ground_wherever_it_lies(write, at):
    def change(data):
        plane = {"shape": "plane", "size": [10000, 10000]}
        data["objects"][0].update(mesh=plane, scale=1, translate=at)
        data["camera"] = {"position": np.add(at, [1, 2, 2]).tolist(), "target": at}

    scene = load_scene(write(change))
    tracer = Tracer(scene, MaterialLibrary.starter())
    away = np.linalg.norm(tracer.corners - tracer.eye, axis=-1).min(axis=1)
    assert (tracer.lift < 1e-5 * away + 1e-5).all() and len(tracer.lift) < 2000
    assert scene.objects[0].mesh.area == pytest.approx(1e8)


@pytest.mark.parametrize("radius, height", [(0.1, 6), (3, 0.5)])
def test_noise_of_temperature_varies_along_the_side_of_a_cylinder(write, radius, height):
    mesh = {"shape": "cylinder", "radius": radius, "height": height}
    field = {"mean_k": 290, "variation_k": 2, "scale_m": 1}
    place = [0, 0, height / 2]
    built = load_scene(
        write(with_object(mesh=mesh, temperature_k=field, scale=1, translate=place))
    ).objects[0]
    assert len(built.mesh.faces) < 100_000 and built.mesh.is_watertight
    middle = built.mesh.triangles_center
    t = built.temperature_k[built.mesh.faces].mean(axis=1) - 290
    assert np.sqrt(((t - 2 * value_noise(middle, 1.0, 0)) ** 2).mean()) < 0.1


@pytest.mark.parametrize("longest_m", [0.3, 1.1, 5.0])
def test_refined_is_the_same_surface(longest_m):
    box = trimesh.creation.box(extents=[3, 2, 1])
    slope = box.vertices @ [1.0, -2.0, 0.5] + 290
    near = lambda middle: np.maximum(longest_m, np.abs(middle[:, 0]))
    v, faces = refined(np.column_stack([box.vertices, slope]), np.asarray(box.faces), near)
    fine = trimesh.Trimesh(v[:, :3], faces, process=False)
    assert fine.is_watertight and fine.is_winding_consistent
    assert fine.volume == pytest.approx(6) and fine.area == pytest.approx(22)
    np.testing.assert_allclose(v[:, 3], v[:, :3] @ [1.0, -2.0, 0.5] + 290)
    edge = v[fine.edges_unique][..., :3]
    assert (fine.edges_unique_length <= near(edge.mean(axis=1))).all()
    assert (v[: len(box.vertices), :3] == box.vertices).all()


def test_of_an_stl_vertices_cannot_be_listed(write):
    with pytest.raises(InputError, match="no vertices of its own"):
        load_scene(write(with_object(mesh="rock.stl", temperature_k=[290, 291, 292, 293])))


def test_vertices_of_a_ply_are_the_file_s_whatever_its_texture_does(write, tmp_path):
    """A seam: the shared edge has other coordinates in either triangle; the first vertex has
    none."""
    (tmp_path / "seam.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\n"
        "property float z\nelement face 2\nproperty list uchar int vertex_indices\n"
        "property list uchar float texcoord\nend_header\n"
        "9 9 9\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
        "3 1 2 3 6 0 0 1 0 1 1\n3 1 3 4 6 0.5 0 0.5 1 0 0.7\n"
    )
    t = [400, 290, 291, 292, 293]
    how = dict(mesh="seam.ply", temperature_k=t, scale=1, translate=[0, 0, 0], rotate_z_deg=0)
    built = load_scene(write(with_object(**how))).objects[0]
    corners = {(0, 0): 290, (1, 0): 291, (1, 1): 292, (0, 1): 293}
    for f in built.mesh.faces:
        for i in f:
            x, y, _ = built.mesh.vertices[i]
            assert built.temperature_k[i] == corners[x, y]


@pytest.mark.parametrize("first", range(5))
def test_a_face_with_a_notch_keeps_it(write, tmp_path, first):
    """Cut like a fan from elsewhere than the notch it would be covered."""
    corners = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 1 0.5 0\nv 0 2 0\n"
    turned = [(first + i) % 5 + 1 for i in range(5)]
    (tmp_path / "q.obj").write_text(f"{corners}f {' '.join(map(str, turned))}\n")
    built = load_scene(write(with_object(mesh="q.obj", scale=1))).objects[0]
    assert built.mesh.area == pytest.approx(2.5)


def ply(corners, faces, text=True, more=""):
    """Bytes of a PLY, each of whose faces may have another property before its corners."""
    head = [
        "ply", f"format {'ascii' if text else 'binary_little_endian'} 1.0",
        f"element vertex {len(corners)}", *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(faces)}", *([f"property uchar {more}"] if more else []),
        "property list uchar int vertex_indices", "end_header", "",
    ]  # fmt: skip
    body, colour = np.array(corners, "<f4").tobytes(), b"\x07" if more else b""
    if text:
        rows = [*corners, *([*([7] if more else []), len(f), *f] for f in faces)]
        body = "".join(" ".join(map(str, row)) + "\n" for row in rows).encode()
    else:
        for f in faces:
            body += colour + bytes([len(f)]) + np.array(f, "<i4").tobytes()
    return "\n".join(head).encode() + body


NOTCHED = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (1, 0.5, 0), (0, 2, 0)]


@pytest.mark.parametrize("first", range(5))
@pytest.mark.parametrize("text", [True, False])
@pytest.mark.parametrize("more", ["", "red"])
def test_so_does_one_of_a_ply(write, tmp_path, first, text, more):
    face = [(first + i) % 5 for i in range(5)]
    (tmp_path / "q.ply").write_bytes(ply(NOTCHED, [face], text, more))
    t = [290, 291, 292, 293, 294]
    how = dict(mesh="q.ply", temperature_k=t, scale=1, translate=[0, 0, 0], rotate_z_deg=0)
    built = load_scene(write(with_object(**how))).objects[0]
    assert built.mesh.area == pytest.approx(2.5)
    here = {tuple(v): k for v, k in zip(built.mesh.vertices, built.temperature_k, strict=True)}
    assert [here[corner] for corner in NOTCHED] == t


def test_a_ply_of_triangles_and_more(write, tmp_path):
    (tmp_path / "q.ply").write_bytes(ply(NOTCHED, [[0, 1, 3], [1, 2, 3], [0, 3, 4, 0]]))
    built = load_scene(write(with_object(mesh="q.ply", scale=1))).objects[0]
    assert built.mesh.area == pytest.approx(2.5)
    for wrong in ([0, 1, 2, 9], [0, 1, 2, -1]):
        (tmp_path / "q.ply").write_bytes(ply(NOTCHED, [wrong]))
        with pytest.raises(InputError, match=f"a face refers to vertex {wrong[-1]} of 5"):
            load_scene(write(with_object(mesh="q.ply")))


@pytest.mark.parametrize("size", [0.01, 0.1, 1.0, 30.0])
def test_rounding_makes_no_notch(write, tmp_path, size):
    """Corners in the middle of edges, written to six decimals."""
    rng = np.random.default_rng(0)
    square = np.array([[0, 0], [1, 0], [2, 0], [2, 1], [2, 2], [1, 2], [0, 2], [0, 1]]) * size / 2
    lines = []
    for turn in range(20):
        basis = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in square @ basis[:2] + [0, 0, turn]]
        lines.append(f"f {' '.join(str(8 * turn + i + 1) for i in range(8))}")
    (tmp_path / "q.obj").write_text("\n".join(lines))
    built = load_scene(write(with_object(mesh="q.obj", scale=1))).objects[0]
    assert built.mesh.area == pytest.approx(20 * size**2, rel=1e-3)


@pytest.mark.parametrize(
    "corners",
    [
        [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)],  # a U
        [(0, 0), (1, 1), (1, 0), (0, 1)],  # a bow tie
        [(0, 0), (2, 2), (2, 0), (0, 1)],
    ],
)
def test_a_face_that_is_no_fan_is_refused(write, tmp_path, corners):
    lines = [f"v {x} {y} 0" for x, y in corners]
    lines.append(f"f {' '.join(str(i + 1) for i in range(len(corners)))}")
    (tmp_path / "q.obj").write_text("\n".join(lines))
    (tmp_path / "q.ply").write_bytes(ply([(*c, 0) for c in corners], [range(len(corners))]))
    for file, named in (("q.obj", "1 2 3 4"), ("q.ply", "0 1 2 3")):
        with pytest.raises(InputError, match=f"vertices {named}.* is no fan of triangles"):
            load_scene(write(with_object(mesh=file)))


def test_a_vertex_of_no_face_moves_no_centre(write, tmp_path):
    square = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nf 1 2 3 4\n"
    how = {"mean_k": 290, "gradient_k_per_m": [0.1, 0, 0]}
    for file, text in (("a.obj", square), ("b.obj", f"{square}v 1000 0 0\n")):
        (tmp_path / file).write_text(text)
        change = with_object(mesh=file, scale=1, translate=[0, 0, 0], temperature_k=how)
        built = load_scene(write(change)).objects[0]
        t = built.temperature_k[np.unique(built.mesh.faces)]
        assert [t.min(), t.max()] == pytest.approx([289.9, 290.1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("camera"), "lacks 'camera'"),
        (lambda d: d.update(objets=[]), "unknown key 'objets'"),
        (lambda d: d.update(objects=[]), "at least one object"),
        (lambda d: d["camera"].update(fov=3), "unknown key 'fov'"),
        (lambda d: d["camera"].update(position=[1, 2]), "position must be 3 numbers"),
        (lambda d: d["camera"].update(position=[1e300, 0, 1]), "within 1e\\+09 m"),
        (lambda d: d["camera"].update(fov_deg="wide"), "fov_deg must be a number"),
        (lambda d: d["camera"].update(fov_deg=500), "1-150"),
        (lambda d: d.update(atmosphere={"humidity": 1}), "unknown key 'humidity'"),
        (lambda d: d.update(atmosphere={"water_cm": 99}), "0-8"),
        (lambda d: d.update(sun_direction=[0, 0, 0]), "not all zero"),
        (with_object(mesh="no.obj"), "no mesh file"),
        (with_object(mesh="scene.json"), "must be an OBJ, a PLY or an STL"),
        (with_object(mesh={"shape": "torus"}), "box, sphere, plane, cylinder"),
        (with_object(mesh={"shape": ["box"]}), "box, sphere, plane, cylinder"),
        (with_object(mesh={"shape": {}}), "box, sphere, plane, cylinder"),
        (with_object(scale=1e30), "beyond 1e\\+09 m"),
        (with_object(scale=1e5), "reaches [12]00 km from the camera; cut it at 20 km"),
        (with_object(mesh={"shape": "sphere"}), "lacks 'radius'"),
        (with_object(mesh={"shape": "sphere", "radius": 0}), "must be positive"),
        (with_object(mesh={"shape": "box", "size": [1, 2]}), "must be 3 numbers"),
        (with_object(scale=-1), "scale must be positive"),
        (with_object(smooth="yes"), "true or false"),
        (with_object(colour="red"), "unknown key 'colour'"),
        (with_object(temperature_k=[280, 281]), "must be 4 numbers"),
        (with_object(temperature_k="hot"), "must be a number"),
        (with_object(temperature_k={"mean_k": 290, "scale_m": 0}), "scale_m must be positive"),
        (with_object(temperature_k={"variation_k": 1}), "lacks 'mean_k'"),
        (with_object(temperature_k=-3), r"1-2000\), .* it has -3 to -3"),
        (with_object(temperature_k=99), "as low as 99; give K, not degrees Celsius"),
        (with_object(temperature_k=10**400), "must be a number, got 1000"),
        (with_object(material="sky"), "made of sky"),
    ],
)
def test_mistakes_are_one_sentence(write, change, message):
    with pytest.raises(InputError, match=message) as caught:
        load_scene(write(change))
    assert "\n" not in str(caught.value) and str(caught.value).count(". ") == 0


def test_vertices_of_an_obj_are_the_file_s(write, tmp_path):
    """Whatever its materials, groups and seams, and letters of its comments: temperatures go by
    them."""
    text = "# Größe\nv 0 0 0\nv 1 0 0\nv 0 0 1\nv 3 0 0\nv 4 0 0\nv 3 0 1\nvt 0 0\nvt 1 1\n"
    text += "usemtl a\nf 1/1 2/2 3/1\ng b\nusemtl b\nf 4/2//1 \\\n 5/1//1 6/1//1\n"
    (tmp_path / "two.obj").write_bytes(text.encode("latin-1"))
    t = [280, 280, 280, 320, 320, 320]
    (two,) = load_scene(write(with_object(mesh="two.obj", temperature_k=t))).objects
    assert two.mesh.vertices.shape == (6, 3) and len(two.mesh.faces) == 2
    for face in two.mesh.faces:
        left = two.mesh.vertices[face, 1].max() < 5  # turned by 90 degrees, moved by 2
        assert (two.temperature_k[face] == (280 if left else 320)).all()


def test_however_an_obj_is_written_it_is_the_same_mesh(write, tmp_path):
    quads = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf {}\nv 0 0 5\nv 1 0 5\nv 0 1 5\nf {}\n"
    plain = quads.format("1 2 3 4", "5 6 7")
    back = quads.format("-4 -3 -2 -1", "-3 -2 -1")  # from where the face stands
    comments = plain.replace("\n", " # x\\\n")
    texts = plain, back, comments, "\ufeff" + plain, plain.replace(" ", "\t")
    meshes = []
    for text in texts:
        (tmp_path / "q.obj").write_text(text, encoding="utf-8")
        meshes.append(load_scene(write(with_object(mesh="q.obj"))).objects[0].mesh)
    assert meshes[0].area == pytest.approx(1.5 * 2**2)
    for m in meshes[1:]:
        np.testing.assert_array_equal(m.triangles, meshes[0].triangles)


@pytest.mark.parametrize(
    "face", ["0 1 2", "1 2 9", "1 2", "-4 1 2", "1 2 x", "", "1 2 3\nv 1 2", "1 2 3\nv 0 nan 1"]
)
def test_an_obj_of_vertices_that_are_not_there_is_refused(write, tmp_path, face):
    (tmp_path / "q.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf {face}\n")
    with pytest.raises(InputError, match="cannot read .*q.obj as a mesh"):
        load_scene(write(with_object(mesh="q.obj")))


@pytest.mark.parametrize(
    ("kind", "before", "said"),
    [
        ("ply", b"comment https", b"comment W\xfcrfel https"),
        ("stl", b"solid ", b"solid W\xfcrfel"),
        ("stl_ascii", b"solid ", b"solid W\xfcrfel"),
    ],
)
def test_a_comment_in_a_mesh_may_have_any_encoding(write, tmp_path, kind, before, said):
    written = trimesh.creation.box().export(file_type=kind)
    written = written.encode() if isinstance(written, str) else written
    path = tmp_path / f"box.{kind[:3]}"
    path.write_bytes(written.replace(before, said, 1))
    (box,) = load_scene(write(with_object(mesh=path.name))).objects
    assert box.mesh.area == pytest.approx(6 * 2**2)
    path.write_bytes(written[: len(written) // 2])
    with pytest.raises(InputError, match=f"is it a whole {kind[:3].upper()}|holds no triangles"):
        load_scene(write(with_object(mesh=path.name)))


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
def test_a_file_s_sharp_edges_stay_sharp_and_what_is_round_is_round(write, tmp_path, suffix):
    trimesh.creation.box().export(tmp_path / f"box.{suffix}")
    trimesh.creation.icosphere(3).export(tmp_path / f"ball.{suffix}")
    sides, own = (
        load_scene(write(with_object(mesh=f"box.{suffix}", **how))).objects[0]
        for how in ({}, {"smooth": False})
    )
    assert sides.smooth and not own.smooth
    at_corners = normals(sides.mesh)[sides.mesh.faces]
    np.testing.assert_allclose(
        at_corners, np.repeat(own.mesh.face_normals[:, None], 3, 1), atol=1e-6
    )
    (ball,) = load_scene(write(with_object(mesh=f"ball.{suffix}"))).objects
    outwards = (ball.mesh.vertices - [1, 2, 3]) / 2
    np.testing.assert_allclose(normals(ball.mesh), outwards, atol=0.02)


@pytest.mark.parametrize("how", [{}, {"smooth": True}])
def test_a_seam_of_vertices_that_are_there_twice_is_round(write, tmp_path, how):
    """As of textures, on both sides of which a file has its own vertices."""
    ball = trimesh.creation.icosphere(3)
    split = trimesh.Trimesh(
        ball.triangles.reshape(-1, 3), np.arange(3 * len(ball.faces)).reshape(-1, 3), process=False
    )
    split.export(tmp_path / "split.ply")
    kelvin = (280 + split.vertices[:, 2]).tolist()
    (of_file,) = load_scene(
        write(with_object(mesh="split.ply", temperature_k=kelvin, **how))
    ).objects
    outwards = (of_file.mesh.vertices - [1, 2, 3]) / 2
    np.testing.assert_allclose(normals(of_file.mesh), outwards, atol=0.02)
    np.testing.assert_allclose(of_file.temperature_k, 280 + outwards[:, 2], atol=1e-4)


def test_a_seam_between_what_is_warm_and_cold_stays_one(write, tmp_path):
    plate = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    corners = np.array([0, 1, 2, 0, 2, 3])
    m = trimesh.Trimesh(np.array(plate)[corners], [[0, 1, 2], [3, 4, 5]], process=False)
    m.export(tmp_path / "plate.ply")
    kelvin = [280, 280, 280, 300, 300, 300]
    (plate,) = load_scene(write(with_object(mesh="plate.ply", temperature_k=kelvin))).objects
    assert sorted(plate.temperature_k[plate.mesh.faces].mean(axis=1)) == [280, 300]


@pytest.mark.parametrize(("sides", "sharp"), [(8, True), (12, False)])
def test_edges_of_more_than_forty_degrees_are_sharp(write, tmp_path, sides, sharp):
    trimesh.creation.cylinder(1, 2, sections=sides).export(tmp_path / "prism.ply")
    m = load_scene(write(with_object(mesh="prism.ply"))).objects[0].mesh
    side = np.abs(m.face_normals[:, 2]) < 0.1
    flat = (normals(m)[m.faces[side]] * m.face_normals[side][:, None]).sum(axis=2) > 0.9999
    assert flat.all() == sharp and flat.any() == sharp


def test_a_ridge_that_fades_is_sharp_while_it_lasts(write, tmp_path):
    x, y = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21), indexing="ij")
    z = 2 * np.maximum(0, 0.4 - np.abs(x)) * np.clip(y + 0.5, 0, 1)
    i, j = (a.ravel() for a in np.meshgrid(range(20), range(20), indexing="ij"))
    a = 21 * i + j
    faces = np.concatenate([np.stack([a, a + 21, a + 22], 1), np.stack([a, a + 22, a + 1], 1)])
    v = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    trimesh.Trimesh(v, faces, process=False).export(tmp_path / "ridge.ply")
    m = load_scene(write(with_object(mesh="ridge.ply"))).objects[0].mesh
    off = np.degrees(np.arccos(np.clip(
        (normals(m)[m.faces] * m.face_normals[:, None]).sum(axis=2), -1, 1
    )))  # fmt: skip
    assert len(m.vertices) > len(v) and off.max() < 40


def test_a_mesh_of_many_parts_stays_as_it_is(write, tmp_path):
    """Of parts times vertices more than 32 bits count."""
    box, n = trimesh.creation.box(), 7000
    v = 0.1 * (box.vertices + 2 * np.arange(n)[:, None, None] * [1, 0, 0]).reshape(-1, 3)
    f = (box.faces + 8 * np.arange(n)[:, None, None]).reshape(-1, 3)
    trimesh.Trimesh(v, f, process=False).export(tmp_path / "many.ply")
    wanted = load_scene(write(with_object(mesh="many.ply", smooth=False))).objects[0].mesh
    m = load_scene(write(with_object(mesh="many.ply"))).objects[0].mesh
    np.testing.assert_allclose(m.triangles, wanted.triangles, atol=1e-5)


def test_vertices_of_a_sharp_edge_keep_their_temperatures(write, tmp_path):
    box = trimesh.creation.box()
    box.export(tmp_path / "box.ply")
    t = 280 + 10 * (box.vertices[:, 2] > 0)
    (of_file,) = load_scene(write(with_object(mesh="box.ply", temperature_k=t.tolist()))).objects
    top = of_file.mesh.vertices[:, 2] > 3  # turned about z, moved by 3
    np.testing.assert_array_equal(of_file.temperature_k, 280 + 10 * top)


def test_triangles_that_are_wound_both_ways_are_round_in_parts(write, tmp_path):
    mesh = trimesh.creation.icosphere(3)
    faces = mesh.faces.copy()
    lower = mesh.triangles_center[:, 2] < 0
    faces[lower] = faces[lower, ::-1]
    trimesh.Trimesh(mesh.vertices, faces, process=False).export(tmp_path / "mixed.ply")
    (mixed,) = load_scene(write(with_object(mesh="mixed.ply"))).objects
    of_corners = normals(mixed.mesh)[mixed.mesh.faces]
    assert ((of_corners * mixed.mesh.face_normals[:, None]).sum(axis=2) > 0.9).all()
    with pytest.raises(InputError, match="wound both ways"):
        load_scene(write(with_object(mesh="mixed.ply", smooth=True)))


def test_a_seed_may_be_any_whole_number(write):
    for seed in (2**31, 2**70):
        field = {"mean_k": 290, "variation_k": 1, "seed": seed}
        t = load_scene(write(with_object(temperature_k=field))).objects[0].temperature_k
        assert 0 < np.abs(t - 290).max() <= 1


@pytest.mark.parametrize("index", [4, 7, -1])
def test_a_triangle_of_a_vertex_that_is_not_there(write, tmp_path, index):
    """As a damaged PLY has it, whose reader does not look."""
    change = with_object(mesh="rock.ply")
    write(change)  # the meshes, too
    trimesh.load(tmp_path / "rock.ply", process=False).export(
        tmp_path / "rock.ply", encoding="ascii"
    )
    assert len(load_scene(tmp_path / "scene.json").objects) == 1
    text = (tmp_path / "rock.ply").read_text().rstrip()
    (tmp_path / "rock.ply").write_text(text[: text.rindex(" ")] + f" {index}\n")
    with pytest.raises(InputError, match="vertices it does not have"):
        load_scene(tmp_path / "scene.json")


def test_unreadable_files(tmp_path):
    with pytest.raises(InputError, match="cannot read"):
        load_scene(tmp_path / "none.json")
    for text in ("{", "[" * 100_000):
        (tmp_path / "bad.json").write_text(text)
        with pytest.raises(InputError, match="not a JSON file"):
            load_scene(tmp_path / "bad.json")
        with pytest.raises(InputError, match="not a JSON file [(][^;]*$"):
            MaterialLibrary.load(tmp_path / "bad.json")
        with pytest.raises(InputError, match="must be JSON"):
            read_bands(tmp_path / "bad.json")


def test_what_is_there_twice_or_unknown_is_not_passed_over(tmp_path):
    path = tmp_path / "b.json"
    columns = '"wavelength_um": [9, 10], "fwhm_um": [0.1, 0.1]'
    path.write_text(f'{{{columns}, "Response": "gaussian"}}')
    with pytest.raises(InputError, match="has an unknown key 'Response'"):
        read_bands(path)
    path.write_text(f'{{{columns}, "fwhm_um": [1, 1]}}')
    with pytest.raises(InputError, match="'fwhm_um' is there twice"):
        read_bands(path)


def test_bands_are_numbers(tmp_path):
    for wrong in ('["10", "11"]', "[true, false]", "[[10], 11]", "9", "[9, NaN]", "[1e400, 9]"):
        (tmp_path / "b.json").write_text(f'{{"wavelength_um": {wrong}, "fwhm_um": [0.1, 0.1]}}')
        with pytest.raises(InputError, match="b.json must be JSON with lists wavelength_um"):
            read_bands(tmp_path / "b.json")
