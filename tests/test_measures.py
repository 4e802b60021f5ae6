"""What benchmarks make of answers, where it is known what that should be."""

from dataclasses import replace

import numpy as np
import pytest
from traced import traced

from benchmarks import band_design, library_from_cube, sigma
from physics import MaterialLibrary


def test_of_gaussian_errors_two_sigmas_are_twice_one():
    rng = np.random.default_rng(0)
    of = rng.uniform(0.1, 3, 400_000)
    row = sigma.row(54, "exact", np.abs(rng.normal(size=of.size) * of), of)
    assert row["quantile_68"] == pytest.approx(1, abs=0.01)
    assert row["quantile_95"] == pytest.approx(2, abs=0.02)
    assert row["within_1_where_95_within_2"] == pytest.approx(sigma.ONE, abs=0.005)
    # half as sure is as good, once it is scaled
    wide = sigma.row(54, "wide", np.abs(rng.normal(size=of.size) * of), 2 * of)
    assert wide["ratio"] == pytest.approx(2, abs=0.03) and wide["quantile_68"] < 0.51


def test_a_library_that_was_found_exactly_has_no_error(monkeypatch):
    """By other names, in another order: each of its curves is compared with its own material's."""
    monkeypatch.setattr(library_from_cube, "METHODS", ("local",))
    cube, truth = traced("patches", 24)
    starter = MaterialLibrary.starter()
    exact = starter.subset(sorted({*np.array(truth.material_names)[truth.material].ravel(), "sky"}))
    other = exact.subset(exact.names[::-1])
    found = replace(other, names=[n if n == "sky" else f"{n}_found" for n in other.names])
    row, materials = library_from_cube.of_scene("patches", cube, truth, exact, found)
    assert len(materials) == row["materials"] >= 3
    assert all(m["found"] == f"{m['material']}_found" and m["rms"] < 1e-12 for m in materials)
    for metric in library_from_cube.COMPARED:
        errors = row[f"{metric}, local, exact"], row[f"{metric}, local, found"]
        assert errors[0] == pytest.approx(errors[1], rel=1e-3)
    # a tenth too high, and so said
    high = replace(found, emissivity=0.9 * found.emissivity + 0.1)
    _, off = library_from_cube.of_scene("patches", cube, truth, exact, high)
    assert off and all(m["mean"] > 0 for m in off)


def test_means_of_a_set_of_filters_are_of_its_own_rows():
    row = dict(filters=4, method="local", set="a", material_accuracy=0.5)
    others = [row | {key: "other"} for key in ("filters", "method", "set")]
    rows = [row, row | {"material_accuracy": 0.7}, row | {"material_accuracy": np.nan}, *others]
    got = band_design._column(rows, 4, "local", "a", "material_accuracy")
    np.testing.assert_array_equal(got, [0.5, 0.7])
