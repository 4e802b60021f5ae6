"""An independent renderer converges to the same image (the benchmark, with few samples)."""

import pytest


def test_difference_to_mitsuba_is_monte_carlo_noise():
    pytest.importorskip("mitsuba")
    from benchmarks.mitsuba_agreement import compare

    result = compare(size=(24, 32), spp=32, seeds=16)[0]
    assert result["agree"], result
    assert result["relative_difference"] < 1e-3
