"""What a pixel can tell: the distances between materials that docs/knowable.png shows."""

import numpy as np
import pytest
from scipy.optimize import minimize

from benchmarks.knowable import (
    BANDS,
    NETD_K,
    SURFACE_K,
    all_apart,
    apart,
    draw,
    enclosure,
    least_sigmas,
    sky_and_ground,
)
from physics.bands import equidistant_bands, quadrature
from physics.library import SKY, MaterialLibrary
from physics.planck import noise_sigma, planck

NAMES = ["water", "bark", "concrete", "glass", "aluminium"]
LIBRARY = MaterialLibrary.starter().subset(NAMES)


def test_two_materials_are_as_far_apart_as_a_search_from_many_starts_says():
    w, fwhm = equidistant_bands(9)
    e = LIBRARY.of_bands(quadrature(w, fwhm))
    objects, noise = sky_and_ground(w), noise_sigma(w, NETD_K)
    seen = e[2] * planck(w, 293.0) + (1 - e[2]) * (0.3 * objects[0] + 0.7 * objects[1])
    for other in e:

        def square(x, other=other):
            t, v = 280 + 10 * x[0], x[1]
            light = v * objects[0] + (1 - v) * objects[1]
            return np.sum(((seen - other * planck(w, t) - (1 - other) * light) / noise) ** 2)

        starts = [(t, v) for t in (-6, -1, 1, 4) for v in (0.0, 0.5, 1.0)]
        bounds = [(-7, 10), (0, 1)]
        found = [minimize(square, x, method="L-BFGS-B", bounds=bounds).fun for x in starts]
        least = apart(seen[None], other, objects, w, noise)[0]
        assert least == pytest.approx(min(found) ** 0.5, rel=1e-3, abs=1e-2)


def test_nothing_is_apart_in_an_isothermal_enclosure_and_more_the_warmer_it_is():
    """S = B(T), whatever e; and twice the contrast is twice the signal, while it is small."""
    alike, little, more = (
        all_apart(LIBRARY, BANDS, enclosure, SURFACE_K + contrast) for contrast in (0, 0.1, 0.2)
    )
    assert alike.max() < 0.02
    others = ~np.eye(len(NAMES), dtype=bool)
    assert more[others] == pytest.approx(2 * little[others], rel=0.05)


def test_a_materials_distance_to_itself_is_none_and_order_does_not_matter():
    d = all_apart(LIBRARY, 4, sky_and_ground, SURFACE_K)
    assert np.abs(np.diag(d)).max() < 0.02
    turned = all_apart(LIBRARY.subset(NAMES[::-1]), 4, sky_and_ground, SURFACE_K)
    assert turned[::-1, ::-1] == pytest.approx(d, rel=1e-9, abs=1e-6)


def test_a_mirrors_t_and_a_black_bodys_v_are_known_worst():
    temperature, lighting = least_sigmas(LIBRARY)
    assert temperature.argmax() == NAMES.index("aluminium") == lighting.argmin()
    assert lighting.argmax() in (NAMES.index("water"), NAMES.index("bark"))


def test_it_draws(tmp_path):
    library = MaterialLibrary.starter()
    draw(library.subset([n for n in library.names if n != SKY]), tmp_path / "knowable.png")
    assert (tmp_path / "knowable.png").read_bytes().startswith(b"\x89PNG")
