"""An independent renderer converges to the same image (the benchmark, with few samples)."""

import numpy as np
import pytest
import trimesh

from benchmarks.mitsuba_agreement import compare, exact_in_both, two_sided
from physics.simulator import geometry


def test_an_open_sheet_becomes_a_thin_solid_that_faces_outwards():
    sheet = geometry.sheet(np.linspace(0, 1, 9), np.linspace(0, 2, 9), lambda p: 0.1 * p[:, 0])
    for m in (sheet, geometry.mesh(sheet.vertices, sheet.faces[:, ::-1])):
        solid = two_sided(m)
        assert solid.is_watertight and solid.is_winding_consistent
        assert solid.volume == pytest.approx(1e-4 * sheet.area, rel=1e-3)
    solid = geometry.sphere(2)
    assert len(two_sided(solid).faces) == len(solid.faces)


def test_the_scene_shows_both_renderers_only_fronts():
    for o in exact_in_both().objects:
        parts = trimesh.Trimesh(o.mesh.vertices, o.mesh.faces)
        assert parts.is_watertight and parts.volume > 0, o.material
        assert np.ptp(o.temperature_k) == 0 and not o.smooth


def test_difference_to_mitsuba_is_monte_carlo_noise():
    pytest.importorskip("mitsuba")
    result = compare(size=(24, 32), seeds=8)[0]
    assert result["agree"], result
    assert abs(result["relative_difference"]) < 1e-3
